"""The background loop of a secured process: a thread with an asyncio loop.

It holds the session with the master (the built-in node's), which also carries rospy's calls to the
master; closes connections whose right has ended; takes new grants. If it fails, no connection would
be closed any more: then all are closed.
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

PERIOD: Final = (
    1.0  # seconds between checks; a connection is closed within the second it expires in
)
_FIRST_WAIT: Final = 5.0  # for the first connection to the master
_RECONNECT_WAIT: Final = 2.0  # how long a call waits for a reconnection
_CALL_DEADLINE: Final = 30.0
_PRESENTED: Final = 64  # as many as the master stores for one node

_ENDED: Final = (
    "the background loop of this process has ended, or is its parent's: a forked process has no"
    " connections, so start it with subprocess, or multiprocessing's spawn"
)

_log = logging.getLogger("rossec.rospy")


class SecuredNode(Protocol):
    """The process that the loop belongs to."""

    rights_version: int
    connections: LiveConnections

    def take_revocations(self, data: bytes, timestamp: bytes, master: Identity) -> None:
        """A list and its confirmation."""

    def close_ended_connections(self) -> None:
        """Close every connection whose right has ended."""

    def run_timers(self) -> None:
        """Renew the keys of idle connections."""


class BackgroundLoop:
    """The background loop of one process."""

    def __init__(
        self,
        process: SecuredNode,
        local_identity: LocalIdentity,
        registrations: Registrations,
        master: tuple[str, int],
    ) -> None:
        self._process = process
        self._local_identity = local_identity
        self._registrations = registrations
        self.address = master
        self._loop = asyncio.new_event_loop()
        self._ready = asyncio.Event()
        self._stop = asyncio.Event()
        self._first_attempt = Event()
        self._grant_directory = GrantDirectory(local_identity.home, local_identity.access)
        self._grant_directory.take_new()
        self._dialer = self._new_dialer()
        self._session = MasterSession(
            local_identity.name,
            self._dial,
            process.take_revocations,
            self._restore,
            lambda: local_identity.revocations.data,
            lambda call: prove(call, local_identity),
        )
        self._renewals = Renewals(local_identity.access)
        self._identity_renewal = IdentityRenewal(
            local_identity.home, LiveCredentials(local_identity.credentials), clock.now()
        )
        self._thread = Thread(target=self._run, name="rossec background", daemon=True)
        self.on_publishers: Callable[[str, list[str]], None] = lambda _topic, _uris: None
        self.on_crash: Callable[[], None] = lambda: None

    def _new_dialer(self) -> Dialer:
        local_identity = self._local_identity
        return Dialer(local_identity.name, local_identity.context, local_identity.access.check_peer)

    # -- from other threads

    def start(self) -> None:
        """Start, and wait a few seconds for the first connection to the master."""
        self._thread.start()
        self._first_attempt.wait(_FIRST_WAIT)

    def stop(self) -> None:
        """End the session."""
        if self._thread.is_alive():
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join(timeout=_RECONNECT_WAIT)

    def call(self, method: str, params: tuple[object, ...]) -> object:
        """The master's answer.

        Raises:
            Fault: it answered with a fault.
            ConnectionRefusedError: it cannot be reached; stock clients raise the same.
        """
        if not self._thread.is_alive():
            raise ConnectionRefusedError(errno.ECONNREFUSED, f"rossec: {_ENDED}")
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
                raise error.__cause__ from None  # not an XML-RPC value: as stock clients
            text = str(error) or "no answer from the master"
            raise ConnectionRefusedError(errno.ECONNREFUSED, f"rossec: {text}") from error

    # -- in the loop

    def _run(self) -> None:
        try:
            with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
                runner.run(self._main())  # its end cancels the calls that wait
        finally:
            self._first_attempt.set()

    async def _main(self) -> None:
        tasks = TaskSet(on_crash=self._on_task_error)
        tasks.spawn(self._run_session(), "rossec session")
        tasks.spawn(self._check_connections(), "rossec connections")
        tasks.spawn(self._maintain_credentials(), "rossec credentials")
        await self._stop.wait()
        await tasks.close()
        await self._session.close()

    def _on_task_error(self, error: BaseException) -> None:
        _log.error("the background loop failed, all connections are closed: %s", error)
        self._process.connections.close_ended(lambda _: "the background loop failed")
        # It unregisters this node at the master, which must not happen in the thread of this loop.
        Thread(target=self.on_crash, name="rossec end", daemon=True).start()
        self._stop.set()

    async def _run_session(self) -> None:
        try:
            await self._session.open()
        except (HintedError, OSError, TimeoutError) as error:
            _log.warning("%s: no answer from the master: %s", self._local_identity.name, error)
        self._first_attempt.set()
        await self._session.run()

    async def _dial(self) -> SecureStream[Identity]:
        self._ready.clear()
        return await self._dialer.rpc(*self.address)

    async def _answer(self, method: str, params: tuple[object, ...]) -> object:
        if not self._ready.is_set():
            async with asyncio.timeout(_RECONNECT_WAIT):
                await self._ready.wait()
        return await self._session.forward(method, *params)

    async def _restore(self, session: MasterSession) -> None:
        """Renew, present and register everything again: the master may have been restarted."""
        self._registrations.session_opened()
        with contextlib.suppress(AnswerRefused):  # retried later
            await renew(session.call, self._renewals, clock.now())
        current = self._local_identity.access.current(clock.now())
        await session.call("rossec.presentGrants", current[:_PRESENTED])
        for method, params in self._registrations.all():
            await self._register(session, method, params)
        self._ready.set()

    async def _register(
        self, session: MasterSession, method: str, params: tuple[object, ...]
    ) -> None:
        answer = await session.forward(method, *params)
        self._registrations.record(method, params, answer)
        match answer:
            case [1, _, list() as uris] if method == "registerSubscriber":
                self.on_publishers(str(params[1]), [uri for uri in uris if isinstance(uri, str)])
            case _:
                pass

    async def _check_connections(self) -> None:
        while True:
            await asyncio.sleep(self._until_next_check())
            self._process.close_ended_connections()
            self._process.run_timers()

    def _until_next_check(self) -> float:
        expiry = self._process.connections.next_expiry
        left = PERIOD if expiry is None else expiry - clock.time()
        return min(PERIOD, max(0.01, left))

    async def _maintain_credentials(self) -> None:
        """Take new grants and a new identity from the node's directory, and renew both."""
        while True:
            await asyncio.sleep(PERIOD)
            new = self._grant_directory.take_new()
            if new:
                _log.info("%s: %d new grants", self._local_identity.name, len(new))
                with contextlib.suppress(
                    HintedError, OSError
                ):  # presented again on the next connection
                    await self._present(new)
                self._process.rights_version += 1
            with contextlib.suppress(HintedError, OSError):
                await self._renew()
            self._refresh_identity()

    async def _renew(self) -> None:
        """Renew grants and identity when due; fetch proofs, where revocations are a tree."""
        call, now = self._session.call, clock.now()
        if await renew(call, self._renewals, now):
            self._process.rights_version += 1
            await self._register_refused()
        await renew_identity(call, self._identity_renewal, now)
        if await prove(call, self._local_identity):
            self._process.close_ended_connections()

    def _refresh_identity(self) -> None:
        """Use a renewed identity for every connection from now on."""
        try:
            renewed = self._local_identity.refresh_identity()
        except (HintedError, OSError) as error:
            _log.warning(
                "%s: the identity in its directory is invalid: %s", self._local_identity.name, error
            )
            return
        if renewed:
            _log.info("%s: uses a new certificate", self._local_identity.name)
            self._dialer = self._new_dialer()

    async def _present(self, new: list[bytes]) -> None:
        await self._session.call("rossec.presentGrants", new)
        await self._register_refused()

    async def _register_refused(self) -> None:
        for method, params in self._registrations.refused():
            await self._register(self._session, method, params)
