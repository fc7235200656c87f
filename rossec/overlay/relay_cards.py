"""A relay's card: what one relay's operator hands to another's, to link their sites. Pure.

JSON with the trust domain, the relay's name, and the key of the mailbox that the other one shall
send to. It is not signed: the peer proves by its certificate who it is, and a forged card only
leads to a mailbox where that proof fails. Whoever reads a card can send to that mailbox, and no
more, so it is handed to its receiver alone. Routers are not in it: each site has its own.
"""

from dataclasses import asdict, dataclass, field, fields
from typing import Final, Self

from ca.errors import NameRefused
from ca.names import check_domain, is_relay_name
from rossec.errors import ConfigurationError, RelayRefused
from rossec.overlay.documents import is_texts, read_document, write_document
from rossec.overlay.mailboxes import is_mailbox

MAX_CARD: Final = 4 * 1024
_FORM: Final = "rossec-relay-card"
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
        keys = frozenset(each.name for each in fields(cls))
        refused = RelayRefused("this is not the card of a relay", _HINT)
        try:
            found = read_document(data, _FORM, keys, limit=MAX_CARD, hint=_HINT)
        except ConfigurationError as error:
            raise refused from error
        if not is_texts(list(found.values())):
            raise refused
        return cls(**found)

    def write(self) -> str:
        """The text of the card."""
        return write_document(_FORM, asdict(self)).decode()
