"""The relay of a site: what its parts are, who of them knows whom, and the link to each peer. A shell.

Forwarded ports lead connections of this site into the link to their peer. Links that peers make lead to
nothing but nodes that its own master says are registered there and, for a foreign peer, exported to it
(docs/spec/overlay.md section 5, "The target"). Masters say which ports there are. A peer is cut when its
descriptor is removed here, its domain is trusted no more, or its identity is revoked.
"""

import asyncio
import logging
import secrets
import socket
import time
from collections.abc import Awaitable, Callable, Mapping
from copy import copy
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from typing import Any, Final, NamedTuple, TypeAlias

from ca.bounded import Newest
from ca.certificates import Identity
from ca.errors import HintedError
from ca.names import RELAY, is_master_name, pattern_covers, shown
from rossec import clock, errors
from rossec.channel.opening import Accepted, classify_caller
from rossec.errors import RelayRefused
from rossec.host import local_ports, runner
from rossec.host.addresses import is_near, source_for
from rossec.host.local_ports import is_here
from rossec.master.state.forwarded_ports import PeerWay, Target
from rossec.net.aio import SecureContext, SecureStream, WireProtocol, connect
from rossec.net.aio.client import dial
from rossec.net.rpc import RpcClient
from rossec.overlay import endpoint, forwarded_ports, link_frames, masters
from rossec.overlay.documents import Peer, Peers
from rossec.overlay.mux import MASTER, NODE, SERVICE, Role, StreamTarget
from rossec.overlay.streams import Pump, Streams
from rossec.participant import delivery_options
from rossec.peer_limits import printable
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


IDLE_FOR: Final = 300.0  # seconds without a stream, after which a link is closed
_FIRST_PAUSE, _LONGEST_PAUSE = 0.5, 5.0  # seconds between two attempts
_log = logging.getLogger("rossec.overlay")
DialPeer: TypeAlias = Callable[[Peer], Awaitable[SecureStream[Identity]]]
"""Makes a link to a peer, which is that peer and admitted. Raises a `HintedError` or `OSError`."""

_SILENT: Final = (
    "does its relay run, does it have the newest descriptor of this one, and is a router in reach?"
)
_ENDED: Final = (
    "the other relay's log says why; it must trust this domain (there: rossec domain list) and have"
    " this relay's descriptor (there: rossec relay list)"
)
MAX_CALLED: Final = 2  # links that one peer has made: a new one, and one that it may have given up
_PERIOD: Final = 1.0
_audit = logging.getLogger("rossec.audit")


class PeerLinkState(Enum):
    IDLE = "idle"
    DIALLING = "dialling"
    LINKED = "linked"
    FAILED = "failed"


class PeerLink:
    """The link that is made to `peer`: dialled when a connection needs it, kept while it carries any, and a
    while longer."""

    def __init__(self, peer: Peer, dial: DialPeer, clock: Callable[[], float] = time.monotonic) -> None:
        self.peer: Final = peer
        self.error = self.hint = ""  # why there is no link, though one was wanted
        self._dial, self._clock = dial, clock
        self._tasks = runner.TaskSet()
        self.stream: SecureStream[Identity] | None = None
        self._streams: Streams | None = None
        self._carrying: asyncio.Task[None] | None = None
        self._dialling: asyncio.Task[Streams | errors.RelayRefused] | None = None
        self._pause = 0.0
        self._said = ""  # in the log, of a failure that goes on
        self._not_before = 0.0

    @property
    def state(self) -> PeerLinkState:
        if self._dialling is not None:
            return PeerLinkState.DIALLING
        if self._streams is not None:
            return PeerLinkState.LINKED
        return PeerLinkState.FAILED if self.error else PeerLinkState.IDLE

    @property
    def carried(self) -> int:
        return 0 if self._streams is None else len(self._streams)

    async def carry(self, target: StreamTarget, sock: socket.socket) -> None:
        try:
            streams = self._streams
            if streams is None or streams.used_up:
                if self._dialling is None:
                    # Those who ask soon after a failure are told it at once: nodes try again by themselves.
                    if self._clock() < self._not_before:
                        raise errors.RelayRefused(self.error, self.hint)
                    self._dialling = self._tasks.spawn(self._make(), f"dialling {self.peer.label}")
                    self._dialling.add_done_callback(self._dialled)
                found = await asyncio.shield(self._dialling)
                if isinstance(found, errors.RelayRefused):
                    raise copy(found)  # others wait for it too
                streams = found
        except BaseException:
            sock.close()
            raise
        await streams.carry(target, sock)

    def tick(self) -> None:
        since = None if self._streams is None else self._streams.idle_since
        if since is not None and self._clock() - since > IDLE_FOR and self._carrying is not None:
            self._settle()
            self._carrying.cancel()

    async def close(self) -> None:
        await self._tasks.close()

    # -- making one

    async def _make(self) -> Streams | errors.RelayRefused:
        try:
            stream = await self._dial(self.peer)
        except (TimeoutError, errors.HandshakeTimeout):  # nobody reads that inbox
            return self._failed(f"{self.peer.label} does not answer", _SILENT)
        except HintedError as error:
            return self._failed(str(error), error.hint)
        except OSError as error:
            return self._failed(f"no link to {self.peer.label}: {error}", _SILENT)
        self.error = self.hint = ""
        self._not_before = 0.0
        streams = Streams(
            stream, Role.CALLER, self.peer.label, round_trip=partial(endpoint.idle_round_trip, stream)
        )
        self.stream, self._streams = stream, streams
        self._carrying = self._tasks.spawn(self._run(stream, streams), f"to {self.peer.label}")
        _log.info("link to %s", self.peer.label)
        return streams

    def _dialled(self, _: object) -> None:
        self._dialling = None

    def _failed(self, text: str, hint: str) -> errors.RelayRefused:
        self._pause = min(max(2 * self._pause, _FIRST_PAUSE), _LONGEST_PAUSE)
        self._not_before = self._clock() + self._pause
        self.error, self.hint = printable(text), printable(hint)
        if self.error != self._said:
            _log.warning("no link to %s: %s (%s)", self.peer.label, self.error, self.hint)
        self._said = self.error
        return errors.RelayRefused(self.error, self.hint)

    def _settle(self) -> None:
        self._pause, self._said = 0.0, ""

    async def _run(self, stream: SecureStream[Identity], streams: Streams) -> None:
        try:
            await streams.run()
        except (errors.HandshakeFailed, errors.PeerRefused) as error:  # whoever is called judges last
            if self.stream is stream:
                self._failed(str(error), _ENDED)
        except (errors.ChannelError, errors.StreamRefused) as error:
            _log.warning("the link to %s ended: %s", self.peer.label, printable(error))
            if self.stream is stream:
                self.error, self.hint = printable(error), _ENDED
                self._settle()
        finally:
            if self.stream is stream:
                self.stream = self._streams = self._carrying = None


class Relay:
    """One relay, from `run` to its end; `admission`: where forwarded ports are, and for whom."""

    def __init__(
        self,
        member: masters.RelayMember,
        network: endpoint.RouterNetwork,
        admission: local_ports.PortAdmission,
        read_peers: Callable[[], Peers],
    ) -> None:
        self._member, self._network, self._read_peers = member, network, read_peers
        self._peers: dict[str, Peer] = {}
        self._links: dict[str, PeerLink] = {}
        self._inboxes: dict[str, endpoint.LinkListener[Identity]] = {}
        self._called: dict[str, list[tuple[SecureStream[Identity], Streams]]] = {}
        self._table: Final = forwarded_ports.ForwardedPortTable(admission, self._carry, self.ways)
        self._masters = masters.OwnMasters(member, secrets.token_hex(16), self._table)
        ports = TopicPorts(member.context, member.name, member.access.check_peer)
        self._targets = Targets(self._masters.target, ports)
        self._tasks = runner.TaskSet(self._crashed)
        self._failure: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._problem = ""

    async def run(self) -> None:
        """Relay until cancelled."""
        self._member.start()
        await self._take_peers()
        self._masters.start()
        try:
            await asyncio.gather(
                self._maintain(),
                self._member.wait_ended(),
                self._masters.wait_failed(),
                asyncio.shield(self._failure),
            )
        finally:
            await self._masters.close()
            await self._table.close()
            for label in tuple(self._peers):
                await self._drop(label)
            await self._tasks.close()
            await self._member.close()
            self._failure.cancel()

    def _crashed(self, error: BaseException) -> None:
        if not self._failure.done():
            self._failure.set_exception(error)

    async def _maintain(self) -> None:
        router = self._network.router
        while True:
            await asyncio.sleep(_PERIOD)
            before, router = router, self._network.router
            if router and router != before:
                _log.warning("router %s is in use now", router)
            elif router != before:
                _log.warning("no router takes the account %s any more; links wait", self._network.account)
            await self._take_peers()
            for link in self._links.values():
                link.tick()

    # -- peers

    async def _take_peers(self) -> None:
        try:
            found = {label: each for label, each in self._read_peers().items() if each.is_complete}
            self._problem = ""
        except HintedError as error:
            if self._problem != str(error):
                _log.warning("%s (%s)", error, error.hint)
            self._problem = str(error)
            return
        for label in [label for label, peer in self._peers.items() if found.get(label) != peer]:
            await self._drop(label)
        for label in found.keys() - self._peers.keys():
            peer = found[label]
            key = link_frames.inbox(self._network.account, bytes.fromhex(peer.box))
            try:
                self._inboxes[label] = self._network.listen(key, partial(self._serve, peer), label)
            except errors.OverlayUnavailable as error:  # tried again in a second
                _log.warning("%s: %s", label, error)
                continue
            self._peers[label] = peer
            self._links[label] = PeerLink(peer, self._dial)

    async def _drop(self, label: str) -> None:
        del self._peers[label]
        _audit.info("no links with %s any more", label)
        self._table.drop_peer(label)
        await self._inboxes.pop(label).close()
        await self._links.pop(label).close()
        for stream, _ in self._called.pop(label, []):
            stream.abort("the peer is removed")

    def ways(self) -> Mapping[str, PeerWay]:
        return {label: self._way(link) for label, link in self._links.items()}

    def _way(self, link: PeerLink) -> PeerWay:
        called = self._called.get(link.peer.label, [])
        streams = [link.stream, *(stream for stream, _ in reversed(called))]
        found = next((stream for stream in streams if stream is not None), None)
        rtt, repeated = (0.0, 0) if found is None else measured(found)
        carried = link.carried + sum(len(each) for _, each in called)
        is_idle = link.state is PeerLinkState.IDLE
        state = PeerLinkState.LINKED if is_idle and called else link.state
        return PeerWay(state.value, rtt, repeated, self._network.router, carried)

    # -- links

    async def _carry(self, target: Target, sock: socket.socket) -> None:
        link = self._links.get(target.peer)
        if link is None:
            sock.close()
            raise errors.RelayRefused(f"no relay is called {target.peer} any more")
        await link.carry(StreamTarget(target.kind, target.name), sock)

    async def _dial(self, peer: Peer) -> SecureStream[Identity]:
        # Say before the handshake what would be less clear after it.
        listed = self._member.trust_status.anchors.listed(peer.domain) if peer.domain else None
        if peer.domain and listed is None:
            raise errors.RelayRefused(
                f"no trusted domain is called {peer.domain}",
                "at this side's authority: rossec domain accept DESCRIPTOR",
            )
        admitted = () if listed is None else listed.entry.admitted
        if listed is not None and not any(pattern_covers(pattern, peer.relay) for pattern in admitted):
            # The options that admit whom the list admits, and so its relays too, but nobody else.
            nodes = [each for each in admitted if not is_master_name(each.replace("*", "x"))]
            options = " ".join(f"--admit '{each}'" for each in nodes or [RELAY])
            raise errors.RelayRefused(
                f"{peer.shown} is not admitted: the domain was accepted before relays were",
                f"at this side's authority: rossec domain limit {peer.domain} {options}",
            )
        stream = await self._network.dial(peer.inbox)
        self._admit(peer, stream)
        return stream

    def _admit(self, peer: Peer, stream: SecureStream[Identity]) -> None:
        try:
            peer.check(stream.peer)
            self._member.admit(stream)
        except BaseException as error:
            stream.abort(str(error))
            raise

    async def _serve(self, peer: Peer, stream: SecureStream[Identity]) -> None:
        try:
            self._admit(peer, stream)
        except HintedError as error:
            where = f"the inbox for {peer.label}"
            delivery_options.warn(_audit, delivery_options.REFUSED, where, shown(stream.peer.name), error)
            return
        remote = LinkPeer(peer.domain or "", peer.name)
        dial = self._targets.dial_for(remote)

        async def connect(target: StreamTarget, pump: Pump) -> socket.socket:
            # For each stream: a link may stand while revocations are stale, and lead to masters only.
            self._member.check_target(stream.peer, target.kind)
            return await dial(target, pump)

        round_trip = partial(endpoint.idle_round_trip, stream)
        streams = Streams(stream, Role.CALLED, peer.label, connect, round_trip=round_trip)
        entry = stream, streams
        called = self._called.setdefault(peer.label, [])
        called.append(entry)
        for older, _ in called[:-MAX_CALLED]:
            older.abort("the peer has made other links")
        _log.info("link from %s", peer.label)
        try:
            await streams.run()
        except (errors.ChannelError, errors.StreamRefused) as error:
            _log.info("the link from %s ended: %s", peer.label, printable(error))
        finally:
            called.remove(entry)

    # -- for people

    def status(self) -> dict[str, Any]:
        return {
            "relay": self._member.name,
            "domain": self._member.identity.domain,
            "account": self._network.account,
            "router": self._network.router,
            "masters": self._masters.status(),
            "peers": [
                {
                    "label": label,
                    "relay": link.peer.shown,
                    **self._way(link)._asdict(),
                    "called": len(self._called.get(label, [])),
                    "error": link.error,
                    "hint": link.hint,
                }
                for label, link in sorted(self._links.items())
            ],
            "forwarded_ports": len(self._table.wanted),
            "problem": self._problem,
        }


def measured(stream: SecureStream[Identity]) -> tuple[float, int]:
    # Round trip in milliseconds, and retransmissions of a link.
    link = getattr(stream.transport, "link", None)
    if link is None:  # it has ended, or is none of the overlay
        return 0.0, 0
    return round(link.stats.srtt_s * 1000, 1), link.stats.retransmissions
