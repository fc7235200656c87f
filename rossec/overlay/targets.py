"""The called side of a stream: to which address it leads, and a connection to there.

A relay connects to nothing but what its own master says is registered there and, for a foreign
peer, exported to it; an address is never the peer's. A target on this host is dialled from an
address that says by whom: through a relay nobody is near (`rossec.net.host.relayed`). The first
bytes show whether the caller speaks rossec, without which nothing is connected, and which of a
node's two ports is meant. A program that is no node is not connected either (`topic_ports`).
"""

import asyncio
import socket
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Final, NamedTuple, Protocol, TypeAlias

from rossec.channel.opening import Accepted, WireProtocol, classify_caller
from rossec.errors import RelayRefused
from rossec.net.aio.dial import dial
from rossec.net.host.relayed import is_near, source_for
from rossec.overlay.mux_units import MASTER, NODE, SERVICE, Target
from rossec.overlay.pump import Pump
from rossec.ros.settings import is_loopback

CONNECT_SECONDS: Final = 5.0
HTTP: Final = WireProtocol.HTTP
TCPROS: Final = WireProtocol.TCPROS
_PROTOCOLS: Final = {MASTER: (HTTP,), NODE: (HTTP, TCPROS), SERVICE: (TCPROS,)}
_LOOPBACK: Final = "127.0.0.1"
_EVERY: Final = "0.0.0.0"  # noqa: S104 - dialled from `source` it would mean that


class Peer(NamedTuple):
    """The relay at the other end of a link.

    Attributes:
        label: what it is called here.
        domain: the label of its foreign domain; empty: the own one.
        name: its name here, `/remote/hospital/relay` or `/relay/ward`.
    """

    label: str
    domain: str
    name: str


Resolve: TypeAlias = Callable[[str, str, str], Awaitable[tuple[str, int]]]
"""Host and port for a domain's label, a kind and a name: what the own master answers.

Raises a `HintedError` where the master refuses, or cannot be asked.
"""


class NodePorts(Protocol):
    """As `rossec.overlay.topic_ports.TopicPorts`: numeric addresses, at which it was looked."""

    async def of(self, name: str, host: str, port: int) -> tuple[str, int]:
        """Where the node's topics are whose slave API is there. Raises a `HintedError`."""

    async def provider(self, host: str, port: int) -> tuple[str, int]:
        """Where the service is that is there. Raises a `HintedError`."""

    def forget(self, name: str, host: str, port: int) -> None:
        """Ask again next time."""


class Targets:
    """Connects streams to targets of this site."""

    def __init__(self, resolve: Resolve, node_ports: NodePorts) -> None:
        self._resolve = resolve
        self._node_ports = node_ports

    def dial_for(self, peer: Peer) -> Callable[[Target, Pump], Awaitable[socket.socket]]:
        """The `Dial` of a link with this peer."""
        return partial(self._dial, peer)

    async def _dial(self, peer: Peer, target: Target, pump: Pump) -> socket.socket:
        protocol = await pump.first_bytes(_protocol)
        if protocol not in _PROTOCOLS[target.kind]:
            raise RelayRefused(f"a caller of the {target.kind} {target.name} in {protocol.value}")
        host, port = await self._resolve(peer.domain, target.kind, target.name)
        place = await self._place(target, protocol, host, port)
        try:
            return await dial_from(source_for(peer.name), *place)
        except OSError:
            self._node_ports.forget(target.name, host, port)
            raise

    async def _place(
        self, target: Target, protocol: WireProtocol, host: str, port: int
    ) -> tuple[str, int]:
        """Where to connect to, of what is registered at this address."""
        if target.kind == MASTER:  # it says where it is itself
            return host, port
        if target.kind == SERVICE:
            return await self._node_ports.provider(host, port)
        address, topics = await self._node_ports.of(target.name, host, port)
        return address, topics if protocol is TCPROS else port


def _protocol(first: bytes) -> WireProtocol | None:
    """The protocol in which a caller of rossec opens the connection; None: not clear yet."""
    match classify_caller(first):
        case None:
            return None
        case Accepted(protocol):
            return protocol
        case _:
            raise RelayRefused("a caller without rossec")


async def dial_from(source: str, host: str, port: int) -> socket.socket:
    """A connection to `host`; from the address `source`, if it is this host.

    Raises:
        RelayRefused: it turned out to be this host after all.
        OSError: it has no address, or nobody accepts.
        TimeoutError: no answer.
    """
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    here = [address for *_, (address, *_) in found if _is_here(str(address))]
    if here:
        return await _dial_here(source, str(here[0]), port)
    sock = await dial(host, port, CONNECT_SECONDS)
    try:
        _check_elsewhere(sock)
    except BaseException:
        sock.close()
        raise
    return sock


async def _dial_here(source: str, address: str, port: int) -> socket.socket:
    """From `source`, which is of IPv4: as 127.0.0.1, if the address is of IPv6 or of every host."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        sock.setblocking(False)
        sock.bind((source, 0))
        where = (_LOOPBACK if ":" in address or address == _EVERY else address, port)
        await asyncio.get_running_loop().sock_connect(sock, where)
    except BaseException:
        sock.close()
        raise
    return sock


def _is_here(address: str) -> bool:
    """Whether this host has the address, or would take it for its own, as 0.0.0.0."""
    try:
        with socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET) as sock:
            sock.bind((address, 0))
    except OSError:
        return is_loopback(address)
    return True


def _check_elsewhere(sock: socket.socket) -> None:
    """Refuse a connection to this host that is not from an address that says by whom."""
    near, far = str(sock.getsockname()[0]), str(sock.getpeername()[0])
    if is_near(far, near):
        raise RelayRefused(f"the target at {far} is this host after all")
