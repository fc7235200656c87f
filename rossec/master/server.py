"""The running master: secure connections in, calls dispatched, answers out. A shell.

Judgement is elsewhere: the gatekeeper says who may do what, `Standing` which grants hold, the
registry what follows. One loop owns all state, and a call is answered without waiting for anybody,
so there is nothing to lock. What events mean is in `consequences`, what holds although nobody calls
in `upkeep`, connections to nodes in `dialling`.
"""

import asyncio
import logging
import os
import secrets
import time
from collections.abc import Callable
from functools import partial
from typing import Final

from ca.errors import HintedError
from rossec.channel.credentials import OwnCredential, Verify
from rossec.channel.known import KnownCertificates
from rossec.channel.records import Limits as ChannelLimits
from rossec.channel.suites import PRODUCTION
from rossec.master.api import MasterApi
from rossec.master.calls import CallRefused, StopMaster
from rossec.master.complaints import Complain, unheard
from rossec.master.consequences import Consequences, State
from rossec.master.dialling import Dialler
from rossec.master.gatekeeper import Caller
from rossec.master.limits import Limits
from rossec.master.memory import ParameterFile
from rossec.master.multicall import MULTICALL, Multicall, Outcome
from rossec.master.news import WATCH_WAIT
from rossec.master.params import Parameters
from rossec.master.registry import Kind, NodeRef, Registry
from rossec.master.standing import ChannelPeer, Standing
from rossec.master.throttle import DENIALS
from rossec.master.updates import LEAVING, Updates
from rossec.master.upkeep import Upkeep
from rossec.master.watching import WATCH, no_news
from rossec.net.halfopen import HalfOpen
from rossec.net.rpc import serve_calls
from rossec.net.stream import Flavour, SecureServer, SecureStream, serve
from rossec.ros.http import HEADERS_LIMIT
from rossec.ros.settings import is_loopback
from rossec.ros.text import printable
from rossec.ros.xmlrpc import Fault

DEFAULT_NAME: Final = "/master"
TIMESTAMP_EVERY: Final = 10.0  # seconds; a timestamp holds for 30
_LIMITS: Final = Limits()
PEER_CONNECTIONS: Final = _LIMITS.connections_per_identity

_denials = logging.getLogger(DENIALS)


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
        self._credentials = credentials
        self._verify = verify
        self._standing = standing
        self._name = name
        self._listen = (host, port)
        self._advertise = advertise
        self._clock = clock
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
        self._dialler = Dialler(
            credentials,
            verify,
            self._on_other,
            limits=self._channel_limits,
            suites=suites,
            known=self._known,
        )
        self._updates = Updates(self._dialler.dial, limits.nodes_per_identity + LEAVING)
        state = State(name, self._now, self._registry, standing, self._updates, memory)
        self._news, self._streams = state.news, state.streams
        self._consequences = Consequences(state, complain, self._on_revocations)
        self._upkeep = Upkeep(state, self._consequences.deliver, timestamp_every, look_after_self)

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
        self._upkeep.begin(self._api)

    def _remember(self) -> Parameters | None:
        if self._memory is None:
            return None
        self._memory.open()
        return self._memory.parameters

    def status(self) -> dict[str, str | int]:
        """What an administrator may ask at any time: figures only."""
        entries = [entry for kind in Kind for entry in self._registry.entries(kind)]
        return {
            "uri": self.uri,
            "pid": os.getpid(),
            "calls": self._consequences.calls,
            "denials": self._consequences.denials,
            "nodes": len(tuple(self._registry.nodes())),
            "registrations": sum(len(names) for _, names in entries),
            "connections": 0 if self._server is None else self._server.connections,
            "revocation_number": self._standing.number,
        }

    def stop(self, reason: str) -> None:
        """End, as an administrator asked."""
        self._consequences.deliver(StopMaster(reason))

    async def stopped(self) -> None:
        """Wait until an administrator asks the master to end."""
        await self._consequences.stopping.wait()

    async def close(self) -> None:
        """Stop listening, cut all connections, stop telling."""
        await self._upkeep.close()
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
            case [CallRefused(taken_by=NodeRef() as owner)] if owner not in self._dialler.doubted:
                return self._ask_who_is_there(owner, near, method, params, peer)
        answer = self._consequences.follow(outcome)
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
        await self._dialler.doubt(owner)
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
        return self._consequences.follow(self._outcome(near, method, params, peer))

    def _outcome(
        self, near: bool, method: str, params: tuple[object, ...], peer: ChannelPeer
    ) -> Outcome:
        api, caller, now = self._admit(peer)
        return api.call(method, params, caller, now, near=near)

    def _step(self, near: bool, multicall: Multicall, peer: ChannelPeer) -> None:
        api, caller, now = self._admit(peer)
        self._consequences.follow(Outcome(None, api.make(multicall, caller, now, near=near)))

    def _admit(self, peer: ChannelPeer) -> tuple[MasterApi, Caller, int]:
        """Who calls, and what it may do at this moment."""
        if self._api is None:
            raise RuntimeError("a call before the master was started")
        now = self._now()
        try:
            return self._api, self._standing.caller(peer, now), now
        except HintedError as error:  # revoked a moment ago: the connection is being cut
            raise Fault(1, f"rossec: {error}") from error

    def _on_other(self, node: NodeRef, found: ChannelPeer) -> None:
        self._consequences.evict(node, found)

    def _on_revocations(self) -> None:
        self._upkeep.revocations_changed()

    def _now(self) -> int:
        return int(self._clock())
