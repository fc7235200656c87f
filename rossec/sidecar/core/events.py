"""What can happen to a layer: the answers to its commands. One page, nothing else.

A layer is a generator that yields commands and is sent one of these for each. What does not fit
the command is a mistake of the shell and ends the layer, and with it the connection.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from ca.certificates import Identity


@dataclass(frozen=True)
class Opened:
    """This port is open: to the network for `OpenIngress`, on loopback for `OpenEgress`."""

    port: int


@dataclass(frozen=True)
class Answered:
    """An XML-RPC call returned this value."""

    value: object


@dataclass(frozen=True)
class RawResponse:
    """An XML-RPC response that nobody parsed, to be handed on as it is."""

    body: bytes


@dataclass(frozen=True)
class HeaderArrived:
    """The connection header that the other end answered with, at `now`.

    `peer` is who it is if it came from the network, None for a program of this host.
    """

    fields: Mapping[str, bytes]
    peer: Identity | None
    now: int


@dataclass(frozen=True)
class NoAnswer:
    """No answer. `dead`: nobody listens there any more, as opposed to slow or broken."""

    reason: str
    dead: bool = False


@dataclass(frozen=True)
class CommandDone:
    """It is done; there is nothing to say about it."""


Event = Opened | Answered | RawResponse | HeaderArrived | NoAnswer | CommandDone
