"""The relays of other sites that a relay exchanges cards with, and its file of them. Pure.

A label is what a peer is called here. For each peer there is a mailbox of its own, told to nobody
else, so that each peer is cut alone. A link that arrives in it must come from that peer's domain
and relay, and a link to that peer must be answered by it (docs/spec/overlay.md).
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Final

from ca.certificates import Identity
from ca.domains.aliases import alias_of, check_label, display_name, split_alias
from ca.errors import NameRefused
from ca.names import is_relay_name
from rossec.errors import ConfigurationError, RelayRefused
from rossec.overlay.documents import read_document, write_document
from rossec.overlay.mailboxes import BOX, is_mailbox

MAX_PEERS: Final = 64
MAX_FILE: Final = 64 * 1024
_FORM: Final = "rossec-overlay"
_BOX: Final = re.compile(r"[0-9a-f]{32}", re.ASCII)
_HINT: Final = "it is written by `rossec relay card`, `add` and `remove`: use these"


@dataclass(frozen=True)
class Peer:
    """A relay of another site.

    Args:
        label: what it is called here.
        box: of the own mailbox that is told to it alone, hexadecimal.
        domain: the label of its foreign domain; empty: the own one; None: its card is not here,
            and nobody has said it.
        relay: the name it is certified for; empty: its card is not here.
        mailbox: the key of its mailbox for this relay; empty likewise.

    Raises:
        ConfigurationError: one of them is not in form.
    """

    label: str
    box: str = field(repr=False)
    domain: str | None = None
    relay: str = ""
    mailbox: str = field(default="", repr=False)

    def __post_init__(self) -> None:
        try:
            check_label(self.label)
            if self.domain:
                check_label(self.domain)
        except NameRefused as error:
            raise ConfigurationError(str(error), error.hint) from error
        if _BOX.fullmatch(self.box) is None:
            raise ConfigurationError(f"the mailbox for {self.label} has {2 * BOX} digits", _HINT)
        if not self.relay and not self.mailbox:
            return
        if not is_relay_name(self.relay):
            raise ConfigurationError(
                f"{self.relay[:255]!a} is not the name of a relay", "/relay, or /relay/attic"
            )
        if not is_mailbox(self.mailbox) or self.domain is None:
            raise ConfigurationError(f"the card of {self.label} is not complete", _HINT)

    @property
    def is_complete(self) -> bool:
        """Whether its card is here, so that links with it can be made."""
        return bool(self.relay)

    @property
    def name(self) -> str:
        """The relay's name here: `/relay`, of a foreign domain `/remote/hospital/relay`."""
        return alias_of(self.domain, self.relay) if self.domain else self.relay

    @property
    def shown(self) -> str:
        """The same for people: `hospital:/relay`; empty until its card is here."""
        return display_name(self.domain or "", self.relay) if self.relay else ""

    def check(self, found: Identity) -> None:
        """Return if an authenticated relay is this peer.

        Raises:
            RelayRefused: it is another node, or its card is not here.
        """
        alias = split_alias(found.name) if found.is_foreign else None
        label, name = ("", found.name) if alias is None else alias
        if not self.is_complete or (label, name) != (self.domain, self.relay):
            raise RelayRefused(
                f"{display_name(label, name)} is at the mailbox of {self.label},"
                f" not {self.shown or 'a relay whose card is here'}",
                f"exchange cards anew: rossec relay remove {self.label}",
            )


Peers = Mapping[str, Peer]
"""Peers by label."""


def checked_peers(peers: Iterable[Peer]) -> dict[str, Peer]:
    """The peers by label.

    Raises:
        ConfigurationError: a label, a relay or a mailbox is there twice, or there are too many.
    """
    found: dict[str, Peer] = {}
    for each in peers:
        for other in found.values():
            _check_apart(each, other)
        found[each.label] = each
    if len(found) > MAX_PEERS:
        raise ConfigurationError(f"at most {MAX_PEERS} peers of a relay", "run another relay")
    return found


def _check_apart(one: Peer, other: Peer) -> None:
    if one.label == other.label:
        raise ConfigurationError(f"two peers are called {one.label}", "give each its own label")
    same_relay = one.is_complete and (one.domain, one.relay) == (other.domain, other.relay)
    if same_relay or one.box == other.box or (one.is_complete and one.mailbox == other.mailbox):
        raise ConfigurationError(
            f"{other.label} and {one.label} are one relay", f"rossec relay remove {other.label}"
        )


def read_peers(data: bytes, name: str) -> dict[str, Peer]:
    """Read the file of peers, called `name`; a closed schema.

    Raises:
        ConfigurationError: anything else.
    """
    try:
        found = read_document(data, _FORM, frozenset({"peers"}), limit=MAX_FILE, hint=_HINT)
    except ConfigurationError as error:
        raise ConfigurationError(f"{name}: {error}", error.hint) from error
    rows = found["peers"]
    if not isinstance(rows, list):
        raise ConfigurationError(f"{name} is not a list of peers of this form", _HINT)
    return checked_peers(_peer(row, name) for row in rows)


def write_peers(peers: Peers) -> bytes:
    """The content of the file."""
    rows = [asdict(each) for _, each in sorted(peers.items())]
    return write_document(_FORM, {"peers": rows})


def _peer(row: object, name: str) -> Peer:
    match row:
        case {
            "label": str() as label, "box": str() as box, "domain": (str() | None) as domain,
            "relay": str() as relay, "mailbox": str() as mailbox, **rest,
        } if not rest:  # fmt: skip
            return Peer(label, box, domain, relay, mailbox)
    raise ConfigurationError(f"{name} has a peer that is not in form", _HINT)
