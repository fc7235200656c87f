"""One identity of the sidecar: its standing with the master, its doors, and who passes them.

A shell around `layers.Tenant`. Its parts are those of the built-in node: the session, the watch
that cuts what expires or is revoked, the shelf of grants. Each connection runs one layer after
another; whatever goes wrong ends that connection, on both sides.
"""

import asyncio
import contextlib
import logging
import time
from collections.abc import Iterator
from typing import Final

from ca.certificates import Identity
from ca.errors import HintedError, RevocationsStale
from ca.revocation import Revocations, digest
from grants.model import Right
from rossec.channel.credentials import LiveCredentials
from rossec.channel.known import KnownCertificates
from rossec.channel.opening import Flavour
from rossec.channel.suites import PRODUCTION
from rossec.errors import AnswerRefused, CallRefused, HangUp, RossecError
from rossec.home import NodeHome
from rossec.net.rpc import serve_calls
from rossec.net.server import SecureServer, serve_now
from rossec.net.stream import SecureStream, connect
from rossec.net.tasks import TaskSet
from rossec.node.access import Access
from rossec.node.fields import text
from rossec.node.guests import Guests
from rossec.node.identity import IdentityRenewal, renew_identity
from rossec.node.proofs import prove
from rossec.node.questions import MASTER
from rossec.node.renewal import Renewals, renew
from rossec.node.session import MasterSession
from rossec.node.shelf import Shelf
from rossec.node.watch import Watch
from rossec.ros import header
from rossec.ros.settings import Settings, is_loopback
from rossec.ros.xmlrpc import Fault
from rossec.sidecar import headers, mastercalls, pump, slavecalls
from rossec.sidecar.addresses import Doors, Endpoint
from rossec.sidecar.callers import Callers
from rossec.sidecar.doorways import Doorways
from rossec.sidecar.headers import Joined
from rossec.sidecar.layers import Tenant
from rossec.sidecar.loopback import LoopbackPort, free_port
from rossec.sidecar.lost import Lost
from rossec.sidecar.plain import PlainStream
from rossec.sidecar.pump import Link, split_header
from rossec.sidecar.visit import Correspondent, Visit

HEADER_DEADLINE: Final = 15.0  # the program's side of it may have to be reached first
SLAVE_DEADLINE: Final = 30.0
REVOCATION_UPDATE: Final = "rossec.revocationUpdate"
_PRESENTED: Final = 64
_COLLECT: Final = 1.0
_KEEP: Final = 5.0
_ATTEMPTS: Final = 16

_log = logging.getLogger("rossec.sidecar")


class Agent:
    """Acts for the identity in `home`.

    Args:
        outside: where the master is and how peers reach this host.
        callers: which programs may use it.
        master_uri: the loopback master, as its programs know it.
        suites: offered and accepted, in order of preference.
    """

    def __init__(
        self,
        home: NodeHome,
        outside: Settings,
        callers: Callers,
        master_uri: str,
        suites: tuple[int, ...] = PRODUCTION,
    ) -> None:
        self.home = home
        self.callers = callers
        self._outside = outside
        self._suites, self._known = suites, KnownCertificates()
        self._anchor = home.anchor()
        self._credentials = LiveCredentials(home.credentials())
        self._revocations = Revocations(self._anchor.public_key)
        saved = home.load_revocations()
        if saved is not None:
            self._revocations.update(saved, int(time.time()))
        access = Access(self._anchor, self._revocations)
        identity = home.identity(int(time.time()))
        self.tenant = Tenant(identity, access, Doors(outside.address or ""), master_uri)
        self._shelf = Shelf(home, access)
        self._shelf.take_new()
        self._session = MasterSession(
            self.name,
            self._dial_master,
            self._revocations_arrived,
            self._restore,
            lambda: digest(self._revocations.data),
            lambda call: prove(call, self._revocations),
        )
        self._renewals = Renewals(access)
        self._identity_renewal = IdentityRenewal(home, self._credentials, int(time.time()))
        self._guests = Guests()
        self._links: set[Link] = set()
        self._lost = Lost()
        self._watch = Watch(self._revocations, lambda: tuple(self._links), self._guests)
        self._tasks = TaskSet()
        self._watching = TaskSet(self._blind)
        self._is_blind = False
        self._exports = Doorways(self._close_outside)
        self._imports = Doorways(self._close_inside)
        self._kept: dict[Endpoint, Correspondent] = {}
        self._opening = asyncio.Lock()
        self._started = False

    @property
    def name(self) -> str:
        """The certified name."""
        return self.home.name

    async def call_master(self, method: str, params: tuple[object, ...]) -> object:
        """Answer a program's call to its master."""
        await self._start()
        visit = Visit(self)
        try:
            return await visit.run(mastercalls.call(self.tenant, method, params))
        finally:
            await visit.close()

    async def close(self) -> None:
        """Close every door, end every connection."""
        for server in self._exports:
            await server.close()
        for door in self._imports:
            await door.close()
        await self._watching.close()
        await self._tasks.close()
        await self._session.close()

    # --- what a visit needs

    def export(self, local: Endpoint) -> int:
        """The port outside for `local`."""
        server = self._exports.ask(local, lambda: self._open_outside(local))
        server.wake()
        return server.port

    def rest(self, local: Endpoint) -> None:
        """Refuse callers for `local`: the program is gone."""
        server = self._exports.get(local)
        if server is not None:
            server.rest()

    def bring(self, remote: Endpoint) -> int:
        """The loopback port for `remote`; it listens."""
        door = self._door(remote)
        door.open()
        return door.port

    def shut(self, remote: Endpoint) -> int:
        """The loopback port for `remote`; it refuses callers."""
        door = self._door(remote)
        door.rest()
        return door.port

    def keep(self, remote: Endpoint, correspondent: Correspondent) -> None:
        """Keep a connection for the next caller of `remote`, for a moment."""
        old = self._kept.pop(remote, None)
        self._kept[remote] = correspondent
        self._tasks.spawn(self._let_go(remote, correspondent, old), "a kept connection")

    def kept(self, remote: Endpoint) -> Correspondent | None:
        """Such a connection, for this caller alone."""
        return self._kept.pop(remote, None)

    async def dial(self, remote: Endpoint) -> SecureStream[Identity]:
        """Connect to a peer whose identity holds."""
        stream = await self._connect(remote)
        try:
            self.tenant.access.check_peer(stream.peer, int(time.time()))
        except HintedError as error:
            stream.abort("the peer's identity does not hold")
            raise HangUp(str(error), error.hint) from error
        return stream

    async def _connect(self, remote: Endpoint) -> SecureStream[Identity]:
        return await connect(
            remote.host, remote.port, self._credentials, self._anchor.verify,
            opening=remote.flavour, suites=self._suites, known=self._known,
        )  # fmt: skip

    async def ask_master(self, method: str, params: tuple[object, ...]) -> object:
        """The master's answer; a program that is refused may not show why."""
        answer = await self._session.answer(method, *params)
        match answer:
            case [code, str(status), *_] if code != 1 and status.startswith("rossec: "):
                _log.warning("the master refuses %s: %s", method, status.removeprefix("rossec: "))
            case _:
                pass
        return answer

    def proof(self, right: Right, name: str) -> bytes:
        """Grants that prove `right` on `name`."""
        return self.tenant.access.present(right, name, int(time.time()))

    # --- doors to the network

    def _open_outside(self, local: Endpoint) -> SecureServer[Identity]:
        """A server whose port is named when it is bound, so that the kernel keeps it at rest."""
        host = self.tenant.doors.host
        bind = host if is_loopback(host) else None
        tcpros = local.flavour is Flavour.TCPROS

        async def handler(stream: SecureStream[Identity]) -> None:
            with contextlib.suppress(TimeoutError):
                await (self._admit(local, stream) if tcpros else self._answer(local, stream))

        for attempt in range(_ATTEMPTS):
            try:
                return serve_now(
                    self._guests.bounded(handler), bind, free_port(), self._credentials,
                    self._anchor.verify, accept={local.flavour}, suites=self._suites,
                    known=self._known,
                )  # fmt: skip
            except OSError:
                if attempt == _ATTEMPTS - 1:
                    raise
        raise AssertionError

    def _close_outside(self, local: Endpoint, server: SecureServer[Identity]) -> None:
        self.tenant.doors.closed_outside(local, server.port)
        self.tenant.forget(local)
        self._tasks.spawn(server.close(), f"the door for {local.uri}")

    async def _answer(self, local: Endpoint, stream: SecureStream[Identity]) -> None:
        """A peer's calls to a program's slave API."""
        shown: list[bytes] = []
        visit = Visit(self)

        async def dispatch(method: str, params: tuple[object, ...], peer: Identity) -> object:
            try:
                match method, params:
                    case "rossec.revocationUpdate", (_, bytes() as data, bytes() as timestamp):
                        return self._take_revocations(peer, data, timestamp)
                    case "rossec.presentGrants", (_, bytes() as grants):
                        shown[:] = [grants]
                    case _:
                        pass
                now = int(time.time())
                proof = shown[0] if shown else None
                layer = slavecalls.ask_program(self.tenant, local, peer, method, params, proof, now)
                return await visit.run(layer)
            except HangUp:
                raise
            except HintedError as error:
                _log.warning("refused %s: %s (%s)", peer.name, error, error.hint)
                return [-1, f"rossec: {error}", 0]

        try:
            async with asyncio.timeout(None if stream.peer.name == MASTER else SLAVE_DEADLINE):
                await serve_calls(stream, dispatch)
        finally:
            await visit.close()

    def _take_revocations(self, peer: Identity, data: bytes, timestamp: bytes) -> object:
        if peer.name != MASTER:
            raise CallRefused(f"{REVOCATION_UPDATE} is for the master alone")
        with contextlib.suppress(RevocationsStale):  # which is what this call ends
            self.tenant.access.check_peer(peer, int(time.time()))
        self._revocations_arrived(data, timestamp, peer)
        return [1, "", 0]

    async def _admit(self, local: Endpoint, stream: SecureStream[Identity]) -> None:
        """A peer that subscribes to a program's topic, or calls its service."""
        visit = Visit(self)
        try:
            try:
                async with asyncio.timeout(HEADER_DEADLINE):
                    fields, early = await split_header(stream)
                    layer = headers.admit_peer(
                        self.tenant, local, fields, stream.peer, self.home.filter_key,
                        int(time.time()),
                    )  # fmt: skip
                    joined = await visit.run(layer)
            except HangUp as error:
                _log.info("%s: %s", stream.peer.name, error)
                return
            except HintedError as error:
                _log.warning("refused %s: %s (%s)", stream.peer.name, error, error.hint)
                await stream.send(header.error_header(f"rossec: {error}"))
                return
            if visit.program is not None:
                await self._outward(joined, visit.program, stream, early, visit.first)
        finally:
            await visit.close()

    async def _outward(
        self,
        joined: Joined,
        program: PlainStream,
        stream: SecureStream[Identity],
        early: bytes,
        first: bytes,
    ) -> None:
        with self._linked(stream, joined):
            await stream.send(header.encode(joined.answer))
            if joined.service:
                await pump.exchange(program, stream, first, early)
            elif early:
                _log.warning("%s sends data where it subscribes", stream.peer.name)
            else:
                await pump.publish(program, stream, joined.guard, first)

    # --- doors on loopback

    def _door(self, remote: Endpoint) -> LoopbackPort:
        async def handler(program: PlainStream) -> None:
            if remote.flavour is Flavour.TCPROS:
                await self._reach(remote, program)
            else:
                await self._inquire(remote, program)

        return self._imports.ask(remote, lambda: LoopbackPort(self.callers, handler))

    def _close_inside(self, _: Endpoint, door: LoopbackPort) -> None:
        self.tenant.doors.closed_inside(door.port)
        self._tasks.spawn(door.close(), f"loopback port {door.port}")

    async def _inquire(self, remote: Endpoint, program: PlainStream) -> None:
        """A program's calls to a peer's slave API."""
        visit = Visit(self)

        async def dispatch(method: str, params: tuple[object, ...], _: str) -> object:
            return await visit.run(slavecalls.ask_peer(self.tenant, remote, method, params))

        try:
            await serve_calls(program, dispatch)
        finally:
            await visit.close()

    async def _reach(self, remote: Endpoint, program: PlainStream) -> None:
        """A program that subscribes to a peer's topic, or calls its service."""
        visit = Visit(self)
        try:
            try:
                async with asyncio.timeout(HEADER_DEADLINE):
                    fields, early = await split_header(program)
                    layer = headers.reach_peer(self.tenant, remote, fields, int(time.time()))
                    joined = await visit.run(layer)
            except HangUp as error:
                _log.info("no connection to %s: %s", remote.uri, error)
                return
            except HintedError as error:
                _log.warning("no connection to %s: %s (%s)", remote.uri, error, error.hint)
                await program.send(header.error_header(f"rossec: {error}"))
                await program.close()
                return
            if visit.stream is not None:
                began = time.monotonic()
                await self._inward(joined, program, visit.stream, early, visit.first)
                if not joined.service:
                    self._topic_ended(text(fields, "topic"), began)
        except (RossecError, TimeoutError) as error:
            _log.info("a connection to %s ended: %s", remote.uri, error)
        finally:
            await visit.close()

    async def _inward(
        self,
        joined: Joined,
        program: PlainStream,
        stream: SecureStream[Identity],
        early: bytes,
        first: bytes,
    ) -> None:
        with self._linked(stream, joined):
            await program.send(header.encode(joined.answer))
            if joined.service:
                await pump.exchange(program, stream, early, first)
            else:
                await pump.subscribe(program, stream, first)

    def _topic_ended(self, topic: str, began: float) -> None:
        self._lost.add(topic, began, time.monotonic())
        if not self._may_subscribe(topic):
            _log.warning("%s: no grant for subscribe on %s any more", self.name, topic)

    def _may_subscribe(self, topic: str) -> bool:
        return self.tenant.access.holds(Right.SUBSCRIBE, topic, int(time.time()))

    @contextlib.contextmanager
    def _linked(self, stream: SecureStream[Identity], joined: Joined) -> Iterator[None]:
        """Known to the watch before the first byte of data: a revocation that arrives finds it."""
        link = Link(stream, joined.decision)
        self._links.add(link)
        try:
            yield
        except* RossecError as group:
            _log.info("the connection with %s ended: %s", stream.peer.name, group.exceptions[0])
        finally:
            self._links.discard(link)

    # --- the master

    async def _start(self) -> None:
        """Meet the master; a program that calls before it is there tries again, as in ROS."""
        async with self._opening:
            if self._is_blind:
                raise HangUp("nobody watches over the connections of this identity any more")
            if self._started:
                return
            try:
                stream = await self._session.open()
            except (HintedError, OSError, TimeoutError) as error:
                _log.warning("%s: the master does not answer: %s", self.name, error)
                raise HangUp(str(error)) from error
            self.tenant.doors.host = self._outside.address or stream.local_address
            self._started = True
            self._tasks.spawn(self._session.keep(), f"{self.name}: master session")
            self._watching.spawn(self._watch.run(), f"{self.name}: watch")
            self._tasks.spawn(self._collect_grants(), f"{self.name}: grants")
            self._tasks.spawn(self._return_to_topics(), f"{self.name}: lost topics")

    def _blind(self, _: BaseException) -> None:
        """The watch has died: what it would no longer cut must not go on."""
        self._is_blind = True
        for link in self._links:
            link.stream.abort("nobody watches over it any more")
        self._watching.spawn(self.close(), f"{self.name}: closing after a failure")

    async def _dial_master(self) -> SecureStream[Identity]:
        return await self._connect(
            Endpoint(Flavour.HTTP, self._outside.master_host, self._outside.master_port)
        )

    async def _restore(self, session: MasterSession) -> None:
        with contextlib.suppress(AnswerRefused):  # what is not renewed now is asked for later
            await renew(session.call, self._renewals, int(time.time()))
        current = self.tenant.access.current(int(time.time()))
        await session.call("rossec.presentGrants", current[:_PRESENTED])
        visit = Visit(self)
        try:
            await visit.run(mastercalls.restore(self.tenant))
        finally:
            await visit.close()

    def _revocations_arrived(self, data: bytes, timestamp: bytes, master: Identity) -> None:
        now = int(time.time())
        try:
            self.tenant.access.take_news(data, timestamp, master, now, self.home.save_revocations)
        finally:  # what the list revokes ends, whatever is wrong with the timestamp
            self._watch.cut(now)

    async def _collect_grants(self) -> None:
        while True:
            await asyncio.sleep(_COLLECT)
            new = self._shelf.take_new()
            with contextlib.suppress(HintedError, OSError):  # else with the next connection
                if new:
                    await self._session.call("rossec.presentGrants", new)
                await renew(self._session.call, self._renewals, int(time.time()))
                await renew_identity(self._session.call, self._identity_renewal, int(time.time()))
                if await prove(self._session.call, self._revocations):
                    self._watch.cut(int(time.time()))

    async def _return_to_topics(self) -> None:
        while True:
            await asyncio.sleep(_COLLECT)
            for topic in self._lost.take_due(time.monotonic(), self._may_subscribe):
                visit = Visit(self)
                try:
                    await visit.run(mastercalls.resubscribe(self.tenant, topic))
                except (HintedError, OSError, Fault) as error:
                    _log.info("%s: cannot subscribe %s again: %s", self.name, topic, error)
                finally:
                    await visit.close()

    async def _let_go(
        self, remote: Endpoint, correspondent: Correspondent, old: Correspondent | None
    ) -> None:
        if old is not None:
            await old.client.close()
        await asyncio.sleep(_KEEP)
        if self._kept.get(remote) is correspondent:
            del self._kept[remote]
            await correspondent.client.close()
