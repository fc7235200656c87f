"""The commands a layer can yield, and nothing else.

Programs are reached only at loopback ports, peers only through the secure channel: no command
sends plaintext to another host.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from grants.model import Right
from rossec.sidecar.core.endpoints import Endpoint


@dataclass(frozen=True)
class OpenIngress:
    """Open a network port for a program's endpoint; always the same port. -> Opened"""

    local: Endpoint


@dataclass(frozen=True)
class OpenEgress:
    """Open a loopback port for a peer's endpoint; always the same port. -> Opened

    With `probe` it listens only if the peer answers; otherwise the port stays reserved and the
    kernel refuses callers, as for a dead node.
    """

    remote: Endpoint
    probe: bool = False


@dataclass(frozen=True)
class Suspend:
    """The program at this endpoint has ended: refuse callers, keep the port. -> CommandDone"""

    local: Endpoint


@dataclass(frozen=True)
class CallMaster:
    """Call the secured master. -> Answered, NoAnswer"""

    method: str
    params: tuple[object, ...]


@dataclass(frozen=True)
class CallProgram:
    """Call a program's slave API. -> Answered; NoAnswer"""

    local: Endpoint
    method: str
    params: tuple[object, ...]


@dataclass(frozen=True)
class CallPeer:
    """Call a peer's slave API, after presenting the grants for `right` on it.

    -> Answered; RawResponse if not `parse`; NoAnswer
    """

    remote: Endpoint
    method: str
    params: tuple[object, ...]
    right: Right | None = None
    parse: bool = True


@dataclass(frozen=True)
class AuthenticatePeer:
    """Connect to a peer, whose identity decides on the call or header that follows.

    The next `CallPeer` or `ConnectPeer` there uses this connection. -> PeerAuthenticated, NoAnswer
    """

    remote: Endpoint


@dataclass(frozen=True)
class Probe:
    """Check whether the program still listens. -> CommandDone, NoAnswer"""

    local: Endpoint


@dataclass(frozen=True)
class ConnectProgram:
    """Connect to a program for TCPROS and send this header. -> HeaderArrived, NoAnswer"""

    local: Endpoint
    fields: Mapping[str, bytes]


@dataclass(frozen=True)
class ConnectPeer:
    """Connect to a peer for TCPROS and send this header. -> HeaderArrived, NoAnswer"""

    remote: Endpoint
    fields: Mapping[str, bytes]


Request = (
    CallMaster | CallProgram | CallPeer | AuthenticatePeer | Probe | ConnectProgram | ConnectPeer
)
Command = OpenIngress | OpenEgress | Suspend | Request
