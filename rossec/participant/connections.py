"""The connections of one identity: those a node makes, how many a peer may have, and what cuts them.

A connection is in the table before it is checked once more, and checked before data passes: a revocation that
arrives while it is admitted finds it there, or is found by the check. The tables are thread-safe; a
connection is cut with no lock held. Of many that end at once all are cut before a word is said of one: a line
of the log takes longer than a cut. What a form of a node adds is the stream.
"""

import asyncio
import contextlib
import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from functools import partial
from threading import Lock
from typing import Any, Final, Generic, NamedTuple, Protocol, TypeVar

from ca.certificates import Identity
from ca.errors import NotAdmitted
from ca.names import is_alias, shown
from ca.revocation.trust_status import TrustStatus
from rossec import clock
from rossec.errors import ChannelClosed, ConnectionHeaderRefused, LimitExceeded
from rossec.net.aio import SecureContext, SecureStream, WireProtocol, connect
from rossec.net.aio.server import Handler
from rossec.net.limits import UNSHOWN_BODY
from rossec.net.rpc import Dispatch, RpcClient, serve_calls
from rossec.participant import slave_api
from rossec.participant.access import Access, wire_name
from rossec.participant.authorized import AuthorizedConnection, PeerStream, RenewedGrants, StreamT
from rossec.participant.handshakes import caller_for
from rossec.ros import names

PEER_CONNECTIONS: Final = 256  # of one identity, one for each topic or service: rosbag uses all
UNSHOWN_CONNECTIONS: Final = 32
"""Of those, the ones by which no grant was shown (yet): each is for a header, or a short call."""

WATCH_PERIOD: Final = 1.0  # seconds between checks; an expiry is exact to the second
FOLLOW_PERIOD: Final = 1.0  # seconds, at most, from the master's list to the end of a connection
_REASON: Final = "the master lists this publisher no longer"

Address = tuple[str, int]
CheckPeer = Callable[[Identity, int], None]
PublisherT = TypeVar("PublisherT")
_log = logging.getLogger("rossec.node")


class AcceptedStream(Protocol):
    def disconnect(self) -> None: ...
    def abort(self, reason: str) -> None: ...


class _Accepted(NamedTuple):
    source: bytes | str
    peer: Identity | str
    shown: bool = False  # by a grant that authorized it


class ConnectionTable(Generic[StreamT]):
    """The connections of one identity; `lock` is held while `trust_status` is read, if threads share it."""

    def __init__(
        self,
        trust_status: TrustStatus,
        lock: AbstractContextManager[object] = nullcontext(),  # noqa: B008 - has no state
        most: int | None = None,  # connections of one peer (N8); None: `PEER_CONNECTIONS`
        master: str = names.MASTER,  # which may have more
    ) -> None:
        self._trust_status = trust_status
        self._trust_status_lock = lock
        self._most = most
        self._master = master
        self._lock = Lock()  # never held together with the other one
        self._accepted: dict[AcceptedStream, _Accepted] = {}
        # Of `_accepted`, by source: what is accepted costs the same beside a thousand connections.
        self._by_source: Counter[bytes | str] = Counter()
        self._shown_by_source: Counter[bytes | str] = Counter()
        self._authorized: set[AuthorizedConnection[StreamT, Any]] = set()
        self._closed: str | None = None
        self.renewed: RenewedGrants | None = None  # None: no connection takes renewals

    # -- what peers connect

    def bounded(self, handler: Handler[Identity]) -> Handler[Identity]:
        """Call `handler` for the connections that `accept` admits; the master may have more. It has one for
        each program, of which a sidecar's identity has many."""

        async def serve_one(stream: SecureStream[Identity]) -> None:
            try:
                self.accept(stream, stream.peer, limited=stream.peer.name != self._master)
            except LimitExceeded:
                _log.warning("%s has too many connections", shown(stream.peer.name))
                stream.abort("too many connections of one identity")
                return
            stream.when_closed(partial(self.forget, stream))  # one that lingers counts
            await handler(stream)

        return serve_one

    def accept(self, stream: AcceptedStream, peer: Identity | str, *, limited: bool = True) -> None:
        """Count a connection of `peer` until it is forgotten. A foreign authority certifies any number of
        keys, so its domain counts as one peer."""
        source: bytes | str = peer if isinstance(peer, str) else peer.thumbprint
        if not isinstance(peer, str) and peer.is_foreign:
            source = f"domain {peer.domain}"
        name = peer if isinstance(peer, str) else peer.name
        most = PEER_CONNECTIONS if self._most is None else self._most
        with self._lock:
            if limited:
                # N8: a certified peer can exhaust this node's descriptors as well as a stranger.
                count = self._by_source[source]
                if count >= most:
                    raise LimitExceeded(f"{shown(name)} has {most} connections already")
                # Who has shown a grant may open many at once, as rosbag does for each topic. A
                # plain peer has none to show, and is named by the program.
                has_shown = isinstance(peer, str) or self._shown_by_source[source] > 0
                if not has_shown and count >= UNSHOWN_CONNECTIONS:
                    raise LimitExceeded(
                        f"{shown(name)} has {UNSHOWN_CONNECTIONS} connections without a grant"
                    )
            self._count(self._accepted.pop(stream, None), -1)
            self._accepted[stream] = _Accepted(source, peer)
            self._count(self._accepted[stream], 1)

    def forget(self, stream: AcceptedStream) -> None:
        with self._lock:
            self._count(self._accepted.pop(stream, None), -1)

    def _count(self, accepted: _Accepted | None, change: int) -> None:
        if accepted is None:
            return
        counts = [self._by_source, self._shown_by_source] if accepted.shown else [self._by_source]
        for counter in counts:
            counter[accepted.source] += change
            if not counter[accepted.source]:  # a source that has gone leaves nothing
                del counter[accepted.source]

    # -- what is authorized

    def __iter__(self) -> Iterator[AuthorizedConnection[StreamT, Any]]:
        with self._lock:
            return iter(tuple(self._authorized))

    @property
    def domains(self) -> frozenset[str]:
        with self._lock:
            peers = [each.peer for each in self._accepted.values()]
            peers += [each.stream.peer for each in self._authorized]
        return frozenset(peer.domain for peer in peers if not isinstance(peer, str))

    @property
    def next_expiry(self) -> int | None:
        return min((connection.ends for connection in self), default=None)

    def add(self, connection: AuthorizedConnection[StreamT, Any]) -> None:
        """Add a connection; no data may have passed yet."""
        with self._lock:
            self._authorized.add(connection)
            accepted = self._accepted.get(connection.stream)
            if accepted is not None and not accepted.shown:
                self._accepted[connection.stream] = accepted._replace(shown=True)
                self._shown_by_source[accepted.source] += 1
        try:
            self.check(connection)
        except BaseException:
            self.discard(connection)
            raise
        if self.renewed is not None:
            self.renewed.opened(connection, self._renewed)

    def _renewed(self, connection: AuthorizedConnection[StreamT, Any]) -> None:
        with self._lock:
            accepted = self._accepted.get(connection.stream)
            if accepted is not None:
                renewed = accepted._replace(peer=connection.stream.peer)
                self._accepted[connection.stream] = renewed
        with suppress(ChannelClosed):
            self.check(connection)

    def discard(self, connection: AuthorizedConnection[StreamT, Any]) -> bool:
        with self._lock:
            known = connection in self._authorized
            self._authorized.discard(connection)
            return known

    @contextmanager
    def track(self, connection: AuthorizedConnection[StreamT, Any]) -> Iterator[None]:
        self.add(connection)
        try:
            yield
        finally:
            self.discard(connection)

    def check(self, connection: AuthorizedConnection[StreamT, Any]) -> None:
        now = clock.now()
        with self._trust_status_lock:
            reason = connection.termination_reason(self._trust_status, now)
        if self._closed is None and (reason is None or self._continues(connection, now)):
            return
        reason = self._closed or reason or ""
        connection.stream.abort(reason)
        raise ChannelClosed(reason)

    # -- what must end

    def cut_ended(self, now: int) -> None:
        """Cut what must end at `now`, and all of a revoked identity, or of a domain no longer trusted."""
        connections = tuple(self)
        with self._lock:
            accepted = tuple(self._accepted.items())
        with self._trust_status_lock:
            revoked = self._trust_status.own.entries
            refused = [(stream, self._refusal(each.peer, now)) for stream, each in accepted]
        named = [each for each in connections if not revoked.isdisjoint(each.entries)]
        # 2. What waits for one is told when the stack is unwound, whatever was raised; people are after that.
        with ExitStack() as aborts:
            # 1. Whom the list names first: one of a thousand does not wait until the others are judged.
            ended = self._disconnect_ended(named, now, aborts)
            for stream, reason in refused:
                if reason is not None:
                    _disconnect(stream, reason, aborts)
            ended += self._disconnect_ended(set(connections).difference(named), now, aborts)
        for connection, reason in ended:
            name, right = connection.stream.peer.name, connection.decision.name
            _log.warning("closed the connection with %s (%s): %s", shown(name), shown(right), reason)
        if self.renewed is not None:
            self.renewed.retry(self, now)

    def _disconnect_ended(
        self, connections: Iterable[AuthorizedConnection[StreamT, Any]], now: int, aborts: ExitStack
    ) -> list[tuple[AuthorizedConnection[StreamT, Any], str]]:
        # Those that must end and have been disconnected, with the reasons. What a peer has presented since is
        # judged last: it costs signatures, for which no other may stay open.
        with self._trust_status_lock:
            judged = [(each, each.termination_reason(self._trust_status, now)) for each in connections]
        must_end = [(each, reason) for each, reason in judged if reason is not None]
        must_end.sort(key=lambda each: bool(each[0].presented.by_peer))
        ended = []
        for connection, reason in must_end:
            if not self._continues(connection, now) and self.discard(connection):
                _disconnect(connection.stream, reason, aborts)
                ended.append((connection, reason))
        return ended

    def _continues(self, connection: AuthorizedConnection[StreamT, Any], now: int) -> bool:
        # Whether a connection that must end goes on with what its peer presented meanwhile.
        if self.renewed is None or not self.renewed.continues(connection, now):
            return False
        with self._trust_status_lock:
            return connection.termination_reason(self._trust_status, now) is None

    def _refusal(self, peer: Identity | str, now: int) -> str | None:
        if isinstance(peer, str):
            return None
        # Either authority may end it (attack `foreign-node`).
        domains = dict.fromkeys((self._trust_status.anchors.own.domain, peer.domain))
        if not all(self._trust_status.revoked(each).isdisjoint(peer.keys) for each in domains):
            return "the peer's identity is revoked"
        try:
            self._trust_status.check_trust(peer, now)
        except NotAdmitted as error:
            return str(error)
        return None

    def close(self, reason: str) -> None:
        """Cut every connection, and admit none any more: nothing would cut it."""
        self._closed = reason  # first: what is added meanwhile is cut by its own check
        with ExitStack() as aborts:
            for connection in self:
                if self.discard(connection):
                    _disconnect(connection.stream, reason, aborts)


def _disconnect(stream: AcceptedStream, reason: str, aborts: ExitStack) -> None:
    aborts.callback(stream.abort, reason)  # first: it is in no table any more
    stream.disconnect()


class ConnectionWatchdog:
    """Cuts connections that have expired, were revoked, or whose revocation data is stale.

    It waits for the clock only: a master that hangs must not keep an expired connection open.
    `expire_confirmation` expires the confirmation of the revocation list at that time.
    """

    def __init__(self, connections: ConnectionTable[Any], expire_confirmation: Callable[[int], None]) -> None:
        self._connections = connections
        self._expire_confirmation = expire_confirmation
        self._setbacks = clock.Setbacks()

    async def run(self) -> None:
        while True:
            expiry = self._connections.next_expiry
            left = WATCH_PERIOD if expiry is None else expiry - clock.time()
            await asyncio.sleep(max(0.0, min(WATCH_PERIOD, left)))
            self.check(clock.now())

    def check(self, now: int) -> None:
        # Cut what must end; after the clock was set back, wait for fresh revocation data.
        if self._setbacks.any_new():
            _log.warning(
                "the host's clock went back: new connections are refused"
                " until the master confirms its revocation list again"
            )
            # Open connections keep their grace: a clock that is corrected must not stop a robot (0013).
            self._expire_confirmation(now - 1)
        self._connections.cut_ended(now)


class FollowedPublishers(Generic[PublisherT]):
    """The connections of one identity to publishers of aliases: they end when those are no longer listed.

    What a gateway serves replaces the origin's publishers, and the reverse. roscpp and the built-in node
    leave a publisher that is listed no longer; rospy never does, and would get every message twice, over one
    line more. So its connections are ended for it. Topics of the own domain are left as ROS has them.
    `is_listed`: whether the master lists a publisher of a topic, or may list it again.
    """

    def __init__(self, is_listed: Callable[[str, PublisherT], bool]) -> None:
        self._is_listed = is_listed
        self._lock = Lock()
        self._followed: dict[PeerStream, tuple[str, PublisherT]] = {}

    def add(self, stream: PeerStream, topic: str, publisher: PublisherT) -> None:
        if is_alias(topic):
            with self._lock:
                self._followed[stream] = topic, publisher

    def discard(self, stream: PeerStream) -> None:
        with self._lock:
            self._followed.pop(stream, None)

    async def leave_regularly(self) -> None:
        """Leave publishers that are not listed; it does not return."""
        while True:
            await asyncio.sleep(FOLLOW_PERIOD)
            self.leave_unlisted()

    def leave_unlisted(self) -> None:
        with self._lock:
            followed = tuple(self._followed.items())
        for stream, (topic, publisher) in followed:
            if not self._is_listed(topic, publisher):
                self.discard(stream)
                stream.abort(_REASON)


class OwnAddresses:
    """The addresses a node registered as its own: only a connection to one of them may reach itself. An
    address that a peer sends is not enough: the answer to `requestTopic` could send a node back to itself."""

    def __init__(self) -> None:
        self.host = ""  # that it registers; empty while it does not listen
        self._ports: set[int] = set()

    def add_ports(self, host: str, *ports: int) -> None:
        self.host = host
        self._ports.update(ports)

    def is_own(self, address: Address) -> bool:
        host, port = address
        return self.host != "" and _plain(host) == _plain(self.host) and port in self._ports

    def check_redirect(self, first: Address, then: Address) -> None:
        if self.is_own(then) and not self.is_own(first):
            host, port = first
            raise ConnectionHeaderRefused(f"the node at {host} port {port} sends this node to itself")


def _plain(host: str) -> str:
    return host.lower().removeprefix("[").removesuffix("]")


class Dialer:
    """Connects as one node; `certified`: its name without an anonymous suffix, by default the same.

    A peer is checked before anything is sent: its certificate by the channel, its revocation here. That a
    publisher lacks the right shows in its answer only; by then it has received the topic's name, which the
    master has sent it as well, and the subscriber's grant for that topic.
    """

    def __init__(
        self,
        name: str,
        context: SecureContext[Identity],
        check_peer: CheckPeer,
        own_addresses: OwnAddresses | None = None,
        certified: str = "",
    ) -> None:
        self._name = name
        self._certified = certified or name
        self._context = context
        self._check_peer = check_peer
        self._own_addresses = OwnAddresses() if own_addresses is None else own_addresses

    async def rpc(self, host: str, port: int) -> SecureStream[Identity]:
        """Connect to an API whose owner the caller checks."""
        return await self._connect((host, port), WireProtocol.HTTP)

    async def topic(self, uri: str, topic: str) -> SecureStream[Identity]:
        """Connect to the TCPROS port that the node at `uri` names in its answer to `requestTopic`. At a
        relay's forwarded port that is the same port again: the node names an address of its own network."""
        api = names.parse_uri(uri, "a publisher's URI")
        stream = await self._connect_checked(api, WireProtocol.HTTP)
        try:
            name = wire_name(stream.peer, topic, self._certified)
            caller = caller_for(stream.peer, self._name, self._certified)
            answer = await RpcClient(stream).ask("requestTopic", caller, name, [["TCPROS"]])
        finally:
            stream.close_soon()  # the peer could make this take longer than a caller has
        # The address is the peer's word: it may not lead this node to itself.
        match answer:
            case ["TCPROS", str() as host, int() as port] if 0 < port < 1 << 16:
                named = host, port
            case _:
                raise ConnectionHeaderRefused(
                    f"{shown(stream.peer.name)} offers no connection for {shown(topic)}"
                )
        address = api if names.is_forwarded_port(uri) else named
        self._own_addresses.check_redirect(api, address)
        return await self._connect_checked(address, WireProtocol.TCPROS)

    async def service(self, uri: str) -> SecureStream[Identity]:
        address = names.parse_uri(uri, "a service's URI", scheme="rosrpc")
        return await self._connect_checked(address, WireProtocol.TCPROS)

    async def _connect(self, address: Address, protocol: WireProtocol) -> SecureStream[Identity]:
        to_itself = self._own_addresses.is_own(address)
        return await connect(*address, self._context, protocol, to_itself=to_itself)

    async def _connect_checked(self, address: Address, protocol: WireProtocol) -> SecureStream[Identity]:
        stream = await self._connect(address, protocol)
        try:
            self._check_peer(stream.peer, clock.now())
        except BaseException:
            stream.abort("the peer's identity is revoked or cannot be checked")
            raise
        return stream


async def serve_peer(stream: SecureStream[Identity], dispatch: Dispatch[Identity], access: Access) -> None:
    """Answer the calls of a peer, to a node or a sidecar's program, until it closes or its time is over.

    The master's calls are parsed before those of others, as a revocation is one; its connection has no time
    limit. Another peer has little to say to a node, so it says it in small bodies, and in time.
    """
    if access.is_master(stream.peer):
        stream.raise_unit_limit()
        await serve_calls(stream, dispatch, urgent=True)
        return
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(slave_api.DEADLINE):
            await serve_calls(stream, dispatch, bound=lambda: UNSHOWN_BODY)
