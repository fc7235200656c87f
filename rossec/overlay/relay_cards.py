"""A relay's card: what one relay's operator hands to another's, to link their sites. Pure.

JSON with the trust domain, the relay's name, and the key of the mailbox that the other one shall
send to. It is not signed: the peer proves by its certificate who it is, and a forged card only
leads to a mailbox where that proof fails. Whoever reads a card can send to that mailbox, and no
more, so it is handed to its receiver alone. Routers are not in it: each site has its own.
"""

import json
from dataclasses import dataclass, field
from typing import Final, Self

from ca.errors import NameRefused
from ca.names import check_domain, is_relay_name
from rossec.errors import RelayRefused
from rossec.overlay.mailboxes import is_mailbox

MAX_CARD: Final = 4 * 1024
_FORM: Final = 1
_HINT: Final = "ask for the file that `rossec relay card` wrote at the other site"


@dataclass(frozen=True)
class RelayCard:
    """What a card says.

    Args:
        domain: the trust domain of the relay, as its authority has named it.
        relay: the name it is certified for.
        mailbox: the key of its mailbox for the receiver of the card.
    """

    domain: str
    relay: str
    mailbox: str = field(repr=False)

    def __post_init__(self) -> None:
        try:
            check_domain(self.domain)
        except NameRefused as error:
            raise RelayRefused(f"in the relay's card: {error}", _HINT) from error
        if not is_relay_name(self.relay) or not is_mailbox(self.mailbox):
            raise RelayRefused("the card names no relay, or no mailbox", _HINT)

    @classmethod
    def read(cls, data: bytes) -> Self:
        """Read a card; a closed schema.

        Raises:
            RelayRefused: anything else.
        """
        try:
            found = json.loads(data) if len(data) <= MAX_CARD else None
        except (ValueError, RecursionError):
            found = None
        match found:
            case {
                "rossec-relay-card": 1, "domain": str() as domain, "relay": str() as relay,
                "mailbox": str() as mailbox, **rest,
            } if not rest:  # fmt: skip
                return cls(domain, relay, mailbox)
        raise RelayRefused("this is not the card of a relay", _HINT)

    def write(self) -> str:
        """The text of the card."""
        entries = {"domain": self.domain, "relay": self.relay, "mailbox": self.mailbox}
        return json.dumps({"rossec-relay-card": _FORM, **entries}, indent=1) + "\n"
