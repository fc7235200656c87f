"""The state machine of a connection as one table, and the events it returns.

`TABLE` says what a frame does in a state (a method of `Negotiation`, later of `Connection`) and
which states may follow. A frame that is not in the table ends the connection. The diagram in
docs/spec/channel.md is drawn from it.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Final, Generic, TypeAlias

from ca.errors import HintedError
from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.records import Frame


class ConnectionState(Enum):
    """The state of a connection."""

    OPENING = "opening"
    DRAINING = "draining"
    WAIT_1 = "wait for message_1"
    WAIT_2 = "wait for message_2"
    WAIT_3 = "wait for message_3"
    WAIT_4 = "wait for message_4"
    OPEN = "open"
    CLOSING = "closing"
    CLOSED = "closed"

    __hash__ = object.__hash__  # members are unique; Enum's own hash is Python, for every look-up


Row: TypeAlias = tuple[str, tuple[ConnectionState, ...]]

TABLE: Final[dict[tuple[ConnectionState, Frame], Row]] = {
    (ConnectionState.WAIT_1, Frame.HANDSHAKE): (
        "on_message_1",
        (ConnectionState.WAIT_3, ConnectionState.WAIT_1),
    ),
    (ConnectionState.WAIT_2, Frame.HANDSHAKE): ("on_message_2", (ConnectionState.WAIT_4,)),
    (ConnectionState.WAIT_2, Frame.ERROR): ("on_error", (ConnectionState.WAIT_2,)),
    (ConnectionState.WAIT_3, Frame.HANDSHAKE): ("on_message_3", (ConnectionState.OPEN,)),
    (ConnectionState.WAIT_3, Frame.ERROR): ("on_error", ()),
    (ConnectionState.WAIT_4, Frame.HANDSHAKE): ("on_message_4", (ConnectionState.OPEN,)),
    (ConnectionState.WAIT_4, Frame.ERROR): ("on_error", ()),
    (ConnectionState.OPEN, Frame.DATA): ("_on_data", (ConnectionState.OPEN,)),
    (ConnectionState.OPEN, Frame.DATA_END): ("_on_data_end", (ConnectionState.OPEN,)),
    (ConnectionState.OPEN, Frame.PADDED_END): ("_on_padded_end", (ConnectionState.OPEN,)),
    (ConnectionState.OPEN, Frame.REKEY): ("_on_rekey", (ConnectionState.OPEN,)),
    (ConnectionState.OPEN, Frame.CLOSE): ("_on_close", (ConnectionState.CLOSED,)),
    (ConnectionState.OPEN, Frame.IDENTITY): ("_on_identity", (ConnectionState.OPEN,)),
    (ConnectionState.OPEN, Frame.GRANTS): ("_on_grants", (ConnectionState.OPEN,)),
}
"""Errors are unauthenticated, so they are not accepted once the handshake is done."""

PREAMBLE: Final = frozenset({ConnectionState.OPENING, ConnectionState.DRAINING})
UNAUTHENTICATED: Final = frozenset(
    {ConnectionState.WAIT_1, ConnectionState.WAIT_2, ConnectionState.WAIT_3}
)
HANDSHAKING: Final = UNAUTHENTICATED | {ConnectionState.WAIT_4}
FRAMED: Final = HANDSHAKING | {ConnectionState.OPEN}
SENDING: Final = frozenset({ConnectionState.WAIT_4, ConnectionState.OPEN})
ENDED: Final = frozenset({ConnectionState.CLOSING, ConnectionState.CLOSED})


@dataclass(frozen=True, slots=True)
class Authenticated(Generic[PeerT]):
    """The peer proved that it holds the certified key; from here on this side may send.

    An initiator may still be refused until the responder's message_4 arrives.
    """

    identity: PeerT


@dataclass(frozen=True, slots=True)
class UnitReceived:
    """A unit, whole and verified."""

    data: bytes


@dataclass(frozen=True, slots=True)
class Closed:
    """The peer closed in order: it sends nothing more and reads nothing more."""


@dataclass(frozen=True, slots=True)
class IdentityRenewed(Generic[PeerT]):
    """The peer's certificate was renewed: from here on this is its identity."""

    identity: PeerT


@dataclass(frozen=True, slots=True)
class RenewalRefused:
    """A certificate that the peer presented is refused; the one before stays in force."""

    reason: HintedError


@dataclass(frozen=True, slots=True)
class GrantsPresented:
    """Grants the peer presents in place of those before; nothing in them was verified."""

    data: bytes


Renewal: TypeAlias = IdentityRenewed[PeerT] | RenewalRefused | GrantsPresented
Event: TypeAlias = Authenticated[PeerT] | UnitReceived | Closed | Renewal[PeerT]
