"""The called side of a stream: to which address it leads, and a connection to there.

A relay connects to nothing but nodes that its own master says are registered there and, for a foreign
peer, exported to it (docs/spec/overlay.md section 5, "The target").
"""

import asyncio
import socket
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Final, NamedTuple, TypeAlias

from ca.bounded import Newest
from ca.certificates import Identity
from ca.names import shown
from rossec import clock
from rossec.channel.opening import Accepted, classify_caller
from rossec.errors import RelayRefused
from rossec.host.addresses import is_near, source_for
from rossec.host.local_ports import is_here
from rossec.net.aio import SecureContext, WireProtocol, connect
from rossec.net.aio.client import dial
from rossec.net.rpc import RpcClient
from rossec.overlay.mux import MASTER, NODE, SERVICE, StreamTarget
from rossec.overlay.streams import Pump
from rossec.ros import names, xmlrpc

KEPT_SECONDS: Final = 30.0
MOST: Final = 4096
_SERVICE: Final = ""  # as a node's name: of whichever node it is
Place: TypeAlias = tuple[str, int]  # numeric address and port
CONNECT_SECONDS: Final = 5.0
HTTP: Final = WireProtocol.HTTP
TCPROS: Final = WireProtocol.TCPROS
_PROTOCOLS: Final = {MASTER: (HTTP,), NODE: (HTTP, TCPROS), SERVICE: (TCPROS,)}
_LOOPBACK: Final = "127.0.0.1"
_EVERY: Final = "0.0.0.0"  # noqa: S104 - dialled from `source` it would mean that
Resolve: TypeAlias = Callable[[str, str, str], Awaitable[Place]]
"""What the own master answers for a domain's label, a kind and a name. Raises a `HintedError`."""


@dataclass(slots=True)
class _Known:
    turn: asyncio.Lock = field(default_factory=asyncio.Lock)
    place: Place = "", 0
    until: float = 0.0


class TopicPorts:
    """Where nodes of the own domain are: the relay `name` calls at each place, and checks who answers.

    An address that a node registered may be anybody's: so callers are brought to it only after a
    handshake of the relay's own. Whom the node there admits is its decision.
    """

    def __init__(
        self, context: SecureContext[Identity], name: str, check_peer: Callable[[Identity, int], None]
    ) -> None:
        self._context, self._name, self._check_peer = context, name, check_peer
        self._nodes: Newest[tuple[str, str, int], _Known] = Newest(MOST)

    async def of(self, name: str, host: str, port: int) -> Place:
        return await self._kept(name, host, port, partial(self._ask, name))

    async def provider(self, host: str, port: int) -> Place:
        return await self._kept(_SERVICE, host, port, self._call_at)

    def forget(self, name: str, host: str, port: int) -> None:
        for each in (name, _SERVICE):
            self._nodes.pop((each, host, port), None)

    async def _kept(
        self, name: str, host: str, port: int, find: Callable[[str, int], Awaitable[Place]]
    ) -> Place:
        key = name, host, port
        known = self._nodes.get(key)
        if known is None:
            known = self._nodes[key] = _Known()
        async with known.turn:
            if known.until < time.monotonic():
                known.place = await find(host, port)
                known.until = time.monotonic() + KEPT_SECONDS
            return known.place

    async def _call_at(self, host: str, port: int) -> Place:
        stream = await connect(host, port, self._context, WireProtocol.TCPROS)
        try:
            # Some node of the own domain: the caller checks which one provides the service.
            if stream.peer.is_foreign:
                raise RelayRefused(f"{shown(stream.peer.name)} answers at a service's address")
            self._check_peer(stream.peer, clock.now())
            return stream.address, port
        finally:
            await stream.close()

    async def _ask(self, name: str, host: str, port: int) -> Place:
        stream = await connect(host, port, self._context, WireProtocol.HTTP)
        try:
            peer = stream.peer
            if peer.is_foreign or not peer.covers(name):
                raise RelayRefused(f"{shown(peer.name)} answers at the address that {shown(name)} registered")
            self._check_peer(peer, clock.now())
            answer = await RpcClient(stream).ask(names.PORTS, self._name)
        except xmlrpc.Fault as fault:
            raise RelayRefused(
                f"{shown(name)} is older than this relay: {fault.faultString}", "update its rossec"
            ) from fault
        finally:
            await stream.close()
        match answer:
            case [int() as found] if 0 < found < 1 << 16 and not isinstance(found, bool):
                # The numeric address: the name may be resolved to another one the next time.
                return stream.address, found
            case _:
                raise RelayRefused(f"{shown(name)} does not say where its topics are")


class LinkPeer(NamedTuple):
    """The relay at the other end of a link."""

    domain: str  # the label of its foreign domain; empty: the own one
    name: str  # its name here, `/remote/hospital/relay` or `/relay/ward`


class Targets:
    def __init__(self, resolve: Resolve, node_ports: TopicPorts) -> None:
        self._resolve, self._node_ports = resolve, node_ports

    def dial_for(self, peer: LinkPeer) -> Callable[[StreamTarget, Pump], Awaitable[socket.socket]]:
        return partial(self._dial, peer)

    async def _dial(self, peer: LinkPeer, target: StreamTarget, pump: Pump) -> socket.socket:
        # 1. No connection before the caller speaks rossec: a stream reaches nothing but handshakes of nodes.
        protocol = await pump.first_bytes(_protocol)
        if protocol not in _PROTOCOLS[target.kind]:
            raise RelayRefused(f"a caller of the {target.kind} {target.name} in {protocol.value}")
        # 2. Where the own master says it is, if it is shown to that domain; never an address of the peer's.
        host, port = await self._resolve(peer.domain, target.kind, target.name)
        # 3. Who is there: a handshake of the relay's own.
        place = host, port  # of a master: it says where it is itself
        if target.kind == SERVICE:
            place = await self._node_ports.provider(host, port)
        elif target.kind == NODE:
            address, topics = await self._node_ports.of(target.name, host, port)
            place = address, topics if protocol is TCPROS else port
        # 4. From an address that says for whom: through a relay nobody is near.
        try:
            return await dial_from(source_for(peer.name), *place)
        except OSError:
            self._node_ports.forget(target.name, host, port)
            raise


def _protocol(first: bytes) -> WireProtocol | None:
    # The protocol in which a caller of rossec opens the connection; None: not clear yet.
    match classify_caller(first):
        case None:
            return None
        case Accepted(protocol):
            return protocol
        case _:
            raise RelayRefused("a caller without rossec")


async def dial_from(source: str, host: str, port: int) -> socket.socket:
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    # On this host: also where it would take the address for its own, as 0.0.0.0.
    addresses = [str(address) for *_, (address, *_) in found]
    here = [each for each in addresses if is_here(each) or names.is_loopback(each)]
    if here:
        address = here[0]
        sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            sock.setblocking(False)
            sock.bind((source, 0))
            where = _LOOPBACK if ":" in address or address == _EVERY else address
            await loop.sock_connect(sock, (where, port))
        except BaseException:
            sock.close()
            raise
        return sock
    sock = await dial(host, port, CONNECT_SECONDS)
    try:
        # Refuse a connection to this host that is not from an address that says by whom.
        near, far = str(sock.getsockname()[0]), str(sock.getpeername()[0])
        if is_near(far, near):
            raise RelayRefused(f"the target at {far} is this host after all")
    except BaseException:
        sock.close()
        raise
    return sock
