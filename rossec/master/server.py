"""The running master: secure connections in, calls dispatched, changes passed on. A shell.

Judgement is elsewhere: the gatekeeper says who may do what, `Standing` which grants hold, the
registry what follows. One loop owns all state, and a call is answered without waiting for anybody,
so there is nothing to lock. What other nodes must hear goes to `Updates`, which never waits either.
"""

import asyncio
import contextlib
import logging
import os
import secrets
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice
from typing import Final, Protocol

from ca.errors import HintedError
from rossec.channel.credentials import OwnCredential, PeerIdentity, Verify
from rossec.channel.known import KnownCertificates
from rossec.channel.records import Limits as ChannelLimits
from rossec.channel.suites import PRODUCTION
from rossec.errors import CallerMismatch, RossecError
from rossec.master.api import MasterApi
from rossec.master.calls import (
    Administered,
    CallRefused,
    Denied,
    GrantsPresented,
    MasterEvent,
    ParameterChanged,
    ParameterKept,
    RevocationsChanged,
    StopMaster,
)
from rossec.master.complaints import Complain, unheard
from rossec.master.enforce import enforce, steps
from rossec.master.gatekeeper import Caller, Certified, Peer
from rossec.master.limits import Limits
from rossec.master.memory import ParameterFile
from rossec.master.multicall import MULTICALL, Multicall, Outcome
from rossec.master.news import WATCH_WAIT, News
from rossec.master.params import Parameters
from rossec.master.registry import Kind, NodeRef, PublishersChanged, Registry, ShutdownNode
from rossec.master.standing import Statements
from rossec.master.throttle import DENIALS
from rossec.master.updates import CALL_DEADLINE, LEAVING, Updates
from rossec.master.watching import WATCH, no_news
from rossec.net.halfopen import HalfOpen
from rossec.net.rpc import RpcClient, serve_calls
from rossec.net.stream import Flavour, SecureServer, SecureStream, connect, serve
from rossec.net.tasks import TaskSet
from rossec.ros.http import HEADERS_LIMIT
from rossec.ros.settings import is_loopback, parse_uri
from rossec.ros.text import printable
from rossec.ros.xmlrpc import Fault

DEFAULT_NAME: Final = "/master"
TIMESTAMP_EVERY: Final = 10.0  # seconds; a timestamp holds for 30
AT_ONCE: Final = 1024  # steps of judging before the next call is answered; more follow after it
_LIMITS: Final = Limits()
PEER_CONNECTIONS: Final = _LIMITS.connections_per_identity

_log = logging.getLogger(__name__)
_audit = logging.getLogger("rossec.audit")
_denials = logging.getLogger(DENIALS)


class ChannelPeer(Certified, PeerIdentity, Protocol):
    """A peer as the channel hands it over: `ca.certificates.Identity` is one."""


class Standing(Statements, Protocol):
    """What the authority has said and the nodes have shown; `rossec.master.trust` is it."""

    def caller(self, peer: Certified, now: int) -> Caller:
        """Who calls and what it may do now; remembers the peer. Raises `HintedError`: revoked."""

    @property
    def number(self) -> int:
        """Sequence number of the revocation list in force; 0: none."""

    def keep_only(self, thumbprints: frozenset[bytes], now: int) -> None:
        """Forget what identities presented that are neither connected nor registered."""


class MasterServer:
    """`async with`-less on purpose: `start`, then `closed` or `close`.

    Args:
        credentials, verify: the master's own identity, and who may connect.
        standing: grants and revocations.
        name: the master's certified name.
        host: address to listen on (None: all). port: 0 for any free one.
        advertise: host name in `uri`; what nodes are told.
        clock: seconds since the epoch.
        memory: where parameters survive a restart.
        limits: what one peer may cost.
        suites: the post-quantum policy (`rossec.channel.policy`).
        look_after_self: called with the time at every beat (`rossec.master.own`).
    """

    def __init__(
        self,
        credentials: OwnCredential,
        verify: Verify[ChannelPeer],
        standing: Standing,
        *,
        name: str = DEFAULT_NAME,
        host: str | None = None,
        port: int = 11311,
        advertise: str = "localhost",
        clock: Callable[[], float] = time.time,
        timestamp_every: float = TIMESTAMP_EVERY,
        complain: Complain = unheard,
        memory: ParameterFile | None = None,
        limits: Limits = _LIMITS,
        suites: tuple[int, ...] = PRODUCTION,
        look_after_self: Callable[[int], None] = lambda _: None,
    ) -> None:
        self._look_after_self = look_after_self
        self._credentials = credentials
        self._verify = verify
        self._standing = standing
        self._name = name
        self._listen = (host, port)
        self._advertise = advertise
        self._clock = clock
        self._timestamp_every = timestamp_every
        self._complain = complain
        self._memory = memory
        self._limits = limits
        self._channel_limits = ChannelLimits(
            unit=limits.body + HEADERS_LIMIT, handshake_seconds=limits.handshake_seconds
        )
        self._suites = suites
        self._known = KnownCertificates()
        self._registry = Registry(limits.nodes_per_identity)
        self._api: MasterApi | None = None
        self._server: SecureServer[ChannelPeer] | None = None
        self._doubted: set[NodeRef] = set()  # who is being asked whether it is still there
        self._streams: set[SecureStream[ChannelPeer]] = set()
        self._updates = Updates(self._dial, limits.nodes_per_identity + LEAVING)
        self._tasks = TaskSet()
        self._stopping = asyncio.Event()
        self._news = News()
        self._calls = self._denials = 0
        self._changed = asyncio.Event()  # revocations: what follows must not wait for the beat

    @property
    def port(self) -> int:
        """The port listened on."""
        return self._listen[1] if self._server is None else self._server.port

    @property
    def uri(self) -> str:
        """What ROS_MASTER_URI must be set to."""
        host = f"[{self._advertise}]" if ":" in self._advertise else self._advertise
        return f"http://{host}:{self.port}/"

    async def start(self) -> None:
        """Listen.

        Raises:
            OSError: the address is not ours or the port is taken.
        """
        (host, port), limits = self._listen, self._limits
        self._server = serve(
            self._handle,
            host,
            port,
            self._credentials,
            self._verify,
            accept={Flavour.HTTP},
            limits=self._channel_limits,
            half_open=HalfOpen(limits.unfinished_per_address, limits.unfinished),
            suites=self._suites,
            known=self._known,
        )
        self._api = MasterApi(
            self._registry,
            self._standing,
            name=self._name,
            uri=self.uri,
            pid=os.getpid(),
            instance=secrets.token_hex(8),
            started=self._now(),
            parameters=self._remember(),
            parameter_bytes=limits.parameters,
        )
        self._tasks.spawn(self._beat(), name="rossec master timestamps")

    def _remember(self) -> Parameters | None:
        if self._memory is None:
            return None
        self._memory.open()
        return self._memory.parameters

    def status(self) -> dict[str, str | int]:
        """What an administrator may ask at any time: figures only."""
        kinds = {
            kind: sum(len(names) for _, names in self._registry.entries(kind)) for kind in Kind
        }
        return {
            "uri": self.uri,
            "pid": os.getpid(),
            "calls": self._calls,
            "denials": self._denials,
            "nodes": len(tuple(self._registry.nodes())),
            "registrations": sum(kinds.values()),
            "connections": 0 if self._server is None else self._server.connections,
            "revocation_number": self._standing.number,
        }

    def stop(self, reason: str) -> None:
        """End, as an administrator asked."""
        self._deliver(StopMaster(reason))

    async def stopped(self) -> None:
        """Wait until an administrator asks the master to end."""
        await self._stopping.wait()

    async def close(self) -> None:
        """Stop listening, cut all connections, stop telling."""
        await self._tasks.close()
        await self._updates.close()
        if self._server is not None:
            await self._server.close()
        if self._memory is not None:
            self._memory.close()

    async def _handle(self, stream: SecureStream[ChannelPeer]) -> None:
        own = stream.peer.thumbprint
        held = sum(other.peer.thumbprint == own for other in self._streams)
        if held >= self._limits.connections_per_identity:
            _denials.warning("%s has too many connections", stream.peer.name)
            stream.abort("too many connections of one identity")
            return
        self._streams.add(stream)
        try:
            self._standing.caller(stream.peer, self._now())
            near = is_loopback(stream.address) or stream.address == stream.local_address
            await serve_calls(
                stream,
                partial(self._dispatch, near),
                limit=self._limits.body,
                request_deadline=self._limits.request_seconds,
                idle_deadline=self._limits.idle_seconds,
            )
        except HintedError as error:
            _denials.warning("%s is cut off: %s", stream.peer.name, printable(error))
            stream.abort(str(error))
        finally:
            self._streams.discard(stream)

    def _dispatch(
        self, near: bool, method: str, params: tuple[object, ...], peer: ChannelPeer
    ) -> object:
        if method == MULTICALL:
            multicall = Multicall(params)
            self._step(near, multicall, peer)
            return multicall.answer if multicall.done else self._multicall(near, multicall, peer)
        outcome = self._outcome(near, method, params, peer)
        match outcome.events:
            case [CallRefused(taken_by=NodeRef() as owner)] if owner not in self._doubted:
                return self._ask_who_is_there(owner, near, method, params, peer)
        answer = self._follow(outcome)
        if method == WATCH and no_news(answer):
            return self._watch(near, method, params, peer)
        return answer

    async def _ask_who_is_there(
        self,
        owner: NodeRef,
        near: bool,
        method: str,
        params: tuple[object, ...],
        peer: ChannelPeer,
    ) -> object:
        """A node says it is where `owner` was: if somebody else answers there, `owner` is gone."""
        self._doubted.add(owner)
        try:
            with contextlib.suppress(RossecError, OSError, TimeoutError):
                async with asyncio.timeout(CALL_DEADLINE):
                    await (await self._dial(owner)).close()
        finally:
            self._doubted.discard(owner)
        return self._answer(near, method, params, peer)

    async def _watch(
        self, near: bool, method: str, params: tuple[object, ...], peer: ChannelPeer
    ) -> object:
        await self._news.wait(WATCH_WAIT)
        return self._answer(near, method, params, peer)

    async def _multicall(self, near: bool, multicall: Multicall, peer: ChannelPeer) -> object:
        while not multicall.done:
            await asyncio.sleep(0)  # others have their turn
            self._step(near, multicall, peer)
        return multicall.answer

    def _answer(
        self, near: bool, method: str, params: tuple[object, ...], peer: ChannelPeer
    ) -> object:
        return self._follow(self._outcome(near, method, params, peer))

    def _outcome(
        self, near: bool, method: str, params: tuple[object, ...], peer: ChannelPeer
    ) -> Outcome:
        api, caller, now = self._admit(peer)
        return api.call(method, params, caller, now, near=near)

    def _step(self, near: bool, multicall: Multicall, peer: ChannelPeer) -> None:
        api, caller, now = self._admit(peer)
        self._follow(Outcome(None, api.make(multicall, caller, now, near=near)))

    def _admit(self, peer: ChannelPeer) -> tuple[MasterApi, Caller, int]:
        """Who calls, and what it may do at this moment."""
        if self._api is None:
            raise RuntimeError("a call before the master was started")
        now = self._now()
        try:
            return self._api, self._standing.caller(peer, now), now
        except HintedError as error:  # revoked a moment ago: the connection is being cut
            raise Fault(1, f"rossec: {error}") from error

    def _follow(self, outcome: Outcome) -> object:
        """Do what follows from a call; returns the answer."""
        self._calls += 1
        for event in outcome.events:
            self._deliver(event)
        self._news.tell(self._registry.version)
        return outcome.answer

    def _deliver(self, event: MasterEvent) -> None:
        match event:
            case PublishersChanged(topic, subscribers, uris):
                for node in subscribers:
                    self._tell(node, "publisherUpdate", topic, list(uris))
            case ParameterChanged(node, key, value):
                self._tell(node, "paramUpdate", key, value)
            case ShutdownNode(node, reason):
                self._tell(node, "shutdown", f"[{node.name}] Reason: {reason}")
            case RevocationsChanged(by):
                _audit.info("%s brought revocation list %d", by, self._standing.number)
                for _ in islice(self._enforcing(), AT_ONCE):
                    pass
                self._cut_revoked()  # also what it was about to be told
                self._push_revocations()
                self._changed.set()
            case Administered(by, what):
                _audit.info("%s %s", by, printable(what))
            case ParameterKept() | Denied() | GrantsPresented() | CallRefused():
                self._record(event)
            case StopMaster(reason):
                _audit.warning("stopping: %s", printable(reason))
                self._stopping.set()

    def _record(self, event: ParameterKept | Denied | GrantsPresented | CallRefused) -> None:
        match event:
            case ParameterKept(change):
                if self._memory is not None:
                    self._memory.write(change)
            case CallRefused(node, method, status):
                self._denials += 1
                _denials.warning("%s may not %s: %s", node, method, printable(status))
            case Denied(node, right, name):
                self._complain(self._now(), node, right, name)
            case GrantsPresented(name, refused):
                self._news.tell()  # it may see other things now
                if refused:
                    text = printable("; ".join(refused))
                    _denials.warning("%s presents grants that are refused: %s", name, text)

    def _tell(self, node: NodeRef, method: str, subject: object, *rest: object) -> None:
        about = subject if isinstance(subject, str) and rest else ""
        self._updates.post(node, (method, about), self._name, subject, *rest)

    async def _beat(self) -> None:
        while True:
            self._changed.clear()
            try:
                await self._look_around()
            except Exception:  # noqa: BLE001 - one fault must not end freshness and enforcement
                _log.exception("looking after rights failed; it is done again")
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self._timestamp_every):
                    await self._changed.wait()

    async def _look_around(self) -> None:
        self._cut_revoked()
        await self._enforce()
        self._push_revocations()
        self._forget_the_gone()
        self._look_after_self(self._now())
        if self._memory is not None:
            self._memory.sync()

    async def _enforce(self) -> None:
        """Drop what is no longer allowed, tell those concerned; others are answered meanwhile."""
        for _ in self._enforcing():
            self._news.tell(self._registry.version)
            await asyncio.sleep(0)
        self._news.tell()  # what lapsed without a registration may still have been seen

    def _enforcing(self) -> Iterator[None]:
        """Judge all registrations, some at each step."""
        if self._api is not None:
            below = self._api.parameters.below
            for step in steps(self._registry):
                for event in enforce(self._registry, self._standing, step, self._now(), below):
                    self._deliver(event)
                yield

    def _cut_revoked(self) -> None:
        """Cut the connections of revoked identities, and tell them nothing more."""
        now = self._now()
        for stream in tuple(self._streams):
            try:
                self._standing.caller(stream.peer, now)
            except HintedError as error:
                _audit.warning("%s is cut off: %s", stream.peer.name, printable(error))
                self._streams.discard(stream)  # its handler ends in a later turn of the loop
                stream.abort(str(error))
        for node in self._updates.nodes:
            if self._standing.caller_of(node, now) is None:
                self._updates.drop(node)

    def _forget_the_gone(self) -> None:
        nodes = frozenset(self._registry.nodes())
        self._updates.prune(nodes)
        registered = {node.thumbprint for node in nodes}
        connected = {stream.peer.thumbprint for stream in self._streams}
        self._standing.keep_only(frozenset(registered | connected), self._now())
        if self._api is not None:
            self._api.watching.keep_only(frozenset(connected))

    def _push_revocations(self) -> None:
        """Confirm the list to every node, and send it to those that do not hold it."""
        now, key = self._now(), ("rossec.revocationUpdate", "")
        for node in self._registry.nodes():
            revocations, timestamp = self._standing.news_for(node, now)
            if timestamp and self._standing.caller_of(node, now) is not None:
                self._updates.post(node, key, self._name, revocations, timestamp)

    async def _dial(self, node: NodeRef) -> RpcClient:
        """Connect to a slave API; whoever answers must be the node that registered."""
        host, port = parse_uri(node.uri, "the slave API")
        stream = await connect(
            host,
            port,
            self._credentials,
            self._verify,
            opening=Flavour.HTTP,
            limits=self._channel_limits,
            suites=self._suites,
            known=self._known,
        )
        if not stream.peer.covers(node.name) or stream.peer.thumbprint != node.thumbprint:
            stream.abort("not the node that was registered")
            self._evict(node, stream.peer)
            raise CallerMismatch(f"{stream.peer.name} answers at the slave API of {node.name}")
        return RpcClient(stream)

    def _evict(self, node: NodeRef, found: Peer) -> None:
        """Forget a node that registered an address at which another one lives.

        Otherwise whoever is first to register the address of another keeps it out.
        """
        self._updates.drop(node)
        if self._registry.is_current(node):
            _denials.warning("%s is removed: %s answers at %s", node.name, found.name, node.uri)
            for event in self._registry.remove_node(node.name):
                self._deliver(event)
            self._news.tell(self._registry.version)

    def _now(self) -> int:
        return int(self._clock())
