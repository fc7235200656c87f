"""The events that answer a layer's commands, and nothing else.

A layer is a generator: it yields commands and is sent one event for each. An event that does not
fit the command is a bug of the shell; it ends the layer and its connection.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from ca.certificates import Identity


@dataclass(frozen=True)
class Opened:
    """The port that was opened: on the network for `OpenIngress`, on loopback for `OpenEgress`."""

    port: int


@dataclass(frozen=True)
class Answered:
    """An XML-RPC call returned this value; `peer`: the identity of a peer that answered."""

    value: object
    peer: Identity | None = None


@dataclass(frozen=True)
class PeerAuthenticated:
    """A peer is connected, with this identity."""

    peer: Identity


@dataclass(frozen=True)
class RawResponse:
    """An unparsed XML-RPC response, to be forwarded unchanged."""

    body: bytes


@dataclass(frozen=True)
class HeaderArrived:
    """The connection header that the other end answered with, at `now`.

    `peer` is the identity of a peer; None for a program of this host.
    """

    fields: Mapping[str, bytes]
    peer: Identity | None
    now: int


@dataclass(frozen=True)
class NoAnswer:
    """No answer. `dead`: nothing listens there any more, as opposed to slow or broken."""

    reason: str
    dead: bool = False


@dataclass(frozen=True)
class CommandDone:
    """The command was executed; it has no result."""


Event = Opened | Answered | PeerAuthenticated | RawResponse | HeaderArrived | NoAnswer | CommandDone
