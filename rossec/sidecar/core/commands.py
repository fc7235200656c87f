"""What a layer can ask the shell to do. One page, nothing else.

Inside is loopback, where the programs are; outside is the network, where every connection is a
secured one. A layer can reach a program only at a loopback port and a peer only through the
channel: there is no command that would send in clear to another host.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from grants.model import Right
from rossec.sidecar.core.endpoints import Endpoint


@dataclass(frozen=True)
class OpenIngress:
    """Open a door to the network for a program's endpoint, always the same one. -> Opened"""

    local: Endpoint


@dataclass(frozen=True)
class OpenEgress:
    """Open a door on loopback to a peer's endpoint, always the same one. -> Opened

    With `probe` it opens only if somebody answers there; else its number is kept, and callers are
    refused by the kernel as by a dead node.
    """

    remote: Endpoint
    probe: bool = False


@dataclass(frozen=True)
class Suspend:
    """The program behind this endpoint is gone: refuse callers, keep the number. -> Done"""

    local: Endpoint


@dataclass(frozen=True)
class CallMaster:
    """Call the secured master. -> Answered, Silent"""

    method: str
    params: tuple[object, ...]


@dataclass(frozen=True)
class CallProgram:
    """Call a program's slave API. -> Answered; Passed if not `parse`; Silent"""

    local: Endpoint
    method: str
    params: tuple[object, ...]
    parse: bool = True


@dataclass(frozen=True)
class CallPeer:
    """Call a peer's slave API, after showing the grants for `right` on it.

    -> Answered; Passed if not `parse`; Silent
    """

    remote: Endpoint
    method: str
    params: tuple[object, ...]
    right: Right | None = None
    parse: bool = True


@dataclass(frozen=True)
class Probe:
    """See whether the program still listens. -> Done, Silent"""

    local: Endpoint


@dataclass(frozen=True)
class ConnectProgram:
    """Connect to a program for TCPROS and send this header. -> HeaderArrived, Silent"""

    local: Endpoint
    fields: Mapping[str, bytes]


@dataclass(frozen=True)
class ConnectPeer:
    """Connect to a peer for TCPROS and send this header. -> HeaderArrived, Silent"""

    remote: Endpoint
    fields: Mapping[str, bytes]


Request = CallMaster | CallProgram | CallPeer | Probe | ConnectProgram | ConnectPeer
Command = OpenIngress | OpenEgress | Suspend | Request
