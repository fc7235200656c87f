"""One background thread that keeps a process in good standing while rospy runs.

An asyncio loop of its own: the session with the master (the built-in node's), over which all calls
of rospy to the master go as well; the watch over live connections; grants that arrive. When the
guardian dies, nothing would be cut any more: then everything is.
"""

import asyncio
import contextlib
import errno
import logging
from collections.abc import Callable
from threading import Event, Thread
from typing import Final, Protocol

from ca.certificates import Identity
from ca.errors import HintedError
from rossec import clock
from rossec.channel.edhoc.credentials import LiveCredentials
from rossec.errors import AnswerRefused, RossecError
from rossec.inprocess.identity import LocalIdentity
from rossec.inprocess.live_connections import LiveConnections
from rossec.inprocess.registrations import Registrations
from rossec.net.aio import SecureStream
from rossec.net.aio.tasks import TaskSet
from rossec.participant.dialer import Dialer
from rossec.participant.grant_directory import GrantDirectory
from rossec.participant.grant_renewal import Renewals, renew
from rossec.participant.identity_renewal import IdentityRenewal, renew_identity
from rossec.participant.master_session import MasterSession
from rossec.participant.revocation_proofs import prove

PERIOD: Final = 1.0  # seconds between looks; an expiry is met to the second
_PATIENCE: Final = 5.0  # for the first connection to the master
_READY_WITHIN: Final = 2.0  # a call that meets a reconnection waits that long
_CALL_DEADLINE: Final = 30.0
_PRESENTED: Final = 64  # as many as the master keeps of one node

_GONE: Final = (
    "the guardian of this process has ended, or is its parent's: a forked process has no"
    " connections, so start it with subprocess, or multiprocessing's spawn"
)

_log = logging.getLogger("rossec.rospy")


class SecuredNode(Protocol):
    """The process that is kept."""

    rights: int
    links: LiveConnections

    def take_revocations(self, data: bytes, timestamp: bytes, master: Identity) -> None:
        """A list and its confirmation."""

    def cut(self) -> None:
        """End every connection whose right has ended."""

    def run_timers(self) -> None:
        """Keep the keys of idle connections renewed."""


class BackgroundLoop:
    """The guardian of one process."""

    def __init__(
        self,
        process: SecuredNode,
        member: LocalIdentity,
        registrations: Registrations,
        master: tuple[str, int],
    ) -> None:
        self._process = process
        self._member = member
        self._registrations = registrations
        self.address = master
        self._loop = asyncio.new_event_loop()
        self._ready = asyncio.Event()
        self._stop = asyncio.Event()
        self._tried = Event()
        self._shelf = GrantDirectory(member.home, member.access)
        self._shelf.take_new()
        self._dialer = self._new_dialer()
        self._session = MasterSession(
            member.name,
            self._dial,
            process.take_revocations,
            self._restore,
            lambda: member.revocations.data,
            lambda call: prove(call, member),
        )
        self._renewals = Renewals(member.access)
        self._identity_renewal = IdentityRenewal(
            member.home, LiveCredentials(member.credentials), clock.now()
        )
        self._thread = Thread(target=self._run, name="rossec guardian", daemon=True)
        self.on_publishers: Callable[[str, list[str]], None] = lambda _topic, _uris: None
        self.on_crash: Callable[[], None] = lambda: None

    def _new_dialer(self) -> Dialer:
        member = self._member
        return Dialer(
            member.name, member.credentials, member.anchor, member.access.check_peer,
            suites=member.suites,
        )  # fmt: skip

    # -- from other threads

    def start(self) -> None:
        """Begin, and wait a moment for the master: most programs find it there."""
        self._thread.start()
        self._tried.wait(_PATIENCE)

    def stop(self) -> None:
        """End the session."""
        if self._thread.is_alive():
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join(timeout=_READY_WITHIN)

    def call(self, method: str, params: tuple[object, ...]) -> object:
        """The master's answer.

        Raises:
            Fault: it answered with a fault.
            ConnectionRefusedError: it is out of reach, as stock's clients say it.
        """
        if not self._thread.is_alive():
            raise ConnectionRefusedError(errno.ECONNREFUSED, f"rossec: {_GONE}")
        call = self._answer(method, params)
        try:
            waiting = asyncio.run_coroutine_threadsafe(call, self._loop)
        except RuntimeError as error:
            call.close()
            raise ConnectionRefusedError(errno.ECONNREFUSED, "rossec: shut down") from error
        try:
            return waiting.result(_CALL_DEADLINE)
        except (RossecError, TimeoutError, asyncio.CancelledError) as error:
            if isinstance(error.__cause__, (OverflowError, TypeError)):
                raise error.__cause__ from None  # no value of XML-RPC's, as stock's clients say it
            text = str(error) or "no answer from the master"
            raise ConnectionRefusedError(errno.ECONNREFUSED, f"rossec: {text}") from error

    # -- in the loop

    def _run(self) -> None:
        try:
            with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
                runner.run(self._main())  # whoever waits for an answer is told that none comes
        finally:
            self._tried.set()

    async def _main(self) -> None:
        tasks = TaskSet(on_crash=self._crashed)
        tasks.spawn(self._stand(), "rossec session")
        tasks.spawn(self._watch(), "rossec watch")
        tasks.spawn(self._collect(), "rossec grants")
        await self._stop.wait()
        await tasks.close()
        await self._session.close()

    def _crashed(self, error: BaseException) -> None:
        _log.error("the guardian failed, everything is cut: %s", error)
        self._process.links.must_end(lambda _: "the guardian failed")
        # It asks the master to forget this node: not in the thread that speaks to the master.
        Thread(target=self.on_crash, name="rossec end", daemon=True).start()
        self._stop.set()

    async def _stand(self) -> None:
        try:
            await self._session.open()
        except (HintedError, OSError, TimeoutError) as error:
            _log.warning("%s: no answer from the master: %s", self._member.name, error)
        self._tried.set()
        await self._session.run()

    async def _dial(self) -> SecureStream[Identity]:
        self._ready.clear()
        return await self._dialer.rpc(*self.address)

    async def _answer(self, method: str, params: tuple[object, ...]) -> object:
        if not self._ready.is_set():
            async with asyncio.timeout(_READY_WITHIN):
                await self._ready.wait()
        return await self._session.forward(method, *params)

    async def _restore(self, session: MasterSession) -> None:
        """Everything again, for a master that may have been restarted."""
        self._registrations.session_opened()
        with contextlib.suppress(AnswerRefused):  # what is not renewed now is asked for later
            await renew(session.call, self._renewals, clock.now())
        current = self._member.access.current(clock.now())
        await session.call("rossec.presentGrants", current[:_PRESENTED])
        for method, params in self._registrations.all():
            await self._register(session, method, params)
        self._ready.set()

    async def _register(
        self, session: MasterSession, method: str, params: tuple[object, ...]
    ) -> None:
        answer = await session.forward(method, *params)
        self._registrations.note(method, params, answer)
        match answer:
            case [1, _, list() as uris] if method == "registerSubscriber":
                self.on_publishers(str(params[1]), [uri for uri in uris if isinstance(uri, str)])
            case _:
                pass

    async def _watch(self) -> None:
        while True:
            await asyncio.sleep(self._until_next_look())
            self._process.cut()
            self._process.run_timers()

    def _until_next_look(self) -> float:
        soonest = self._process.links.soonest
        left = PERIOD if soonest is None else soonest - clock.time()
        return min(PERIOD, max(0.01, left))

    async def _collect(self) -> None:
        """A grant that arrives in the node's directory counts without a restart."""
        while True:
            await asyncio.sleep(PERIOD)
            new = self._shelf.take_new()
            if new:
                _log.info("%s: %d new grants", self._member.name, len(new))
                with contextlib.suppress(HintedError, OSError):  # else with the next connection
                    await self._use(new)
                self._process.rights += 1
            with contextlib.suppress(HintedError, OSError):
                await self._renew()
            self._follow_identity()

    async def _renew(self) -> None:
        """Grants and identity, when they are due; and proofs, where revocations are a tree."""
        call, now = self._session.call, clock.now()
        if await renew(call, self._renewals, now):
            self._process.rights += 1
            await self._register_refused()
        await renew_identity(call, self._identity_renewal, now)
        if await prove(call, self._member):
            self._process.cut()

    def _follow_identity(self) -> None:
        """A renewed identity counts for every connection from now on."""
        try:
            renewed = self._member.refresh_identity()
        except (HintedError, OSError) as error:
            _log.warning(
                "%s: the identity in its directory is no use: %s", self._member.name, error
            )
            return
        if renewed:
            _log.info("%s: speaks with a new certificate", self._member.name)
            self._dialer = self._new_dialer()

    async def _use(self, new: list[bytes]) -> None:
        await self._session.call("rossec.presentGrants", new)
        await self._register_refused()

    async def _register_refused(self) -> None:
        for method, params in self._registrations.refused():
            await self._register(self._session, method, params)
