"""The background loop of a secured process: a thread with an asyncio loop.

It runs the membership of the process, whose session with the master also carries rospy's calls. If
it fails, no connection would be cut any more: then all are.
"""

import asyncio
import contextlib
import errno
import logging
from collections.abc import Callable
from threading import Event, Thread
from typing import Final

from ca.certificates import Identity
from ca.errors import HintedError
from rossec.errors import RossecError, XmlRpcRefused
from rossec.inprocess.identity import LocalIdentity
from rossec.inprocess.registrations import Registrations
from rossec.inprocess.sockets import RosSocket
from rossec.net.aio import SecureStream
from rossec.participant.connections import ConnectionTable
from rossec.participant.dialer import Dialer
from rossec.participant.followed_publishers import PERIOD, FollowedPublishers
from rossec.participant.membership import Membership
from rossec.ros.xmlrpc import FAULT_CODE, Fault

PEER_CONNECTIONS: Final = 64  # of one identity: one for each topic and service it uses here
_TIMERS_PERIOD: Final = 1.0
_FIRST_WAIT: Final = 5.0  # for the first connection to the master
_RECONNECT_WAIT: Final = 2.0  # how long a call waits for a reconnection
_CALL_DEADLINE: Final = 30.0

_ENDED: Final = (
    "the background loop of this process has ended, or is its parent's: a forked process has no"
    " connections, so start it with subprocess, or multiprocessing's spawn"
)

_log = logging.getLogger("rossec.rospy")


class BackgroundLoop:
    """The background loop of one process, and the hooks of its membership."""

    def __init__(
        self,
        local_identity: LocalIdentity,
        registrations: Registrations,
        master: tuple[str, int],
    ) -> None:
        self._local_identity = local_identity
        self._registrations = registrations
        self.address = master
        self._loop = asyncio.new_event_loop()
        self._ready = asyncio.Event()
        self._stop = asyncio.Event()
        self._first_attempt = Event()
        self._dialer = Dialer(
            local_identity.name, local_identity.live_context, local_identity.access.check_peer
        )
        access = local_identity.access
        self.connections: ConnectionTable[RosSocket] = ConnectionTable(
            local_identity.standing, access.lock, PEER_CONNECTIONS, local_identity.master
        )
        self.membership = Membership(
            local_identity, access, self.connections, registrations.publishers, self, access.lock
        )
        self.followed: FollowedPublishers[str] = FollowedPublishers(registrations.is_publisher)
        self._thread = Thread(target=self._run, name="rossec background", daemon=True)
        self.on_publishers: Callable[[str, list[str]], None] = lambda _topic, _uris: None
        self.on_crash: Callable[[], None] = lambda: None

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
            if isinstance(error, XmlRpcRefused):  # one that stock clients send, and servers refuse
                raise Fault(FAULT_CODE, str(error)) from None
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
        self.membership.start(self._open_session)
        self.membership.tasks.spawn(self._run_timers(), "timers of idle connections")
        self.membership.tasks.spawn(self._leave_publishers(), "publishers to leave")
        await self._stop.wait()
        await self.membership.close()

    async def _open_session(self) -> None:
        try:
            await self.membership.session.open()
        except (HintedError, OSError, Fault) as error:
            _log.warning("%s: no answer from the master: %s", self._local_identity.name, error)
        self._first_attempt.set()

    async def _run_timers(self) -> None:
        """Renew the keys of idle connections, which rospy neither reads nor writes."""
        while True:
            await asyncio.sleep(_TIMERS_PERIOD)
            for connection in self.connections:
                connection.stream.run_timers()

    async def _leave_publishers(self) -> None:
        while True:
            await asyncio.sleep(PERIOD)
            self.followed.leave_unlisted()

    async def _answer(self, method: str, params: tuple[object, ...]) -> object:
        if not self._ready.is_set():
            async with asyncio.timeout(_RECONNECT_WAIT):
                await self._ready.wait()
        return await self.membership.session.forward(method, *params)

    async def _register(self, method: str, params: tuple[object, ...]) -> None:
        answer = await self.membership.session.forward(method, *params)
        self._registrations.record(method, params, answer)
        match answer:
            case [1, _, list() as uris] if method == "registerSubscriber":
                self.on_publishers(str(params[1]), [uri for uri in uris if isinstance(uri, str)])
            case _:
                pass

    # -- in the loop: hooks of the membership (MembershipHooks)

    async def dial_master(self) -> SecureStream[Identity]:
        """Connect to the master; calls wait until everything is registered again."""
        self._ready.clear()
        return await self._dialer.rpc(*self.address)

    async def dial_watch(self) -> SecureStream[Identity]:
        """Connect to the master once more, for a call that waits."""
        return await self._dialer.rpc(*self.address)

    async def restore(self) -> None:
        """Make every registration again."""
        for method, params in self._registrations.table:
            await self._register(method, params)
        self._ready.set()

    async def rights_changed(self) -> None:
        """Make the registrations again that the master refused."""
        for method, params in self._registrations.table.refused():
            await self._register(method, params)

    def maintain(self) -> None:
        """Use the certificate in the directory for every connection from now on."""
        name = self._local_identity.name
        try:
            if self._local_identity.refresh_identity():
                _log.info("%s: uses a new certificate", name)
        except (HintedError, OSError) as error:
            _log.warning("%s: the identity in its directory is invalid: %s", name, error)

    def crashed(self, error: BaseException) -> None:
        """Close every connection, and end the node."""
        _log.error("the background loop failed, all connections are closed: %s", error)
        self.connections.close("the background loop failed")
        # It unregisters this node at the master, which must not happen in the thread of this loop.
        Thread(target=self.on_crash, name="rossec end", daemon=True).start()
        self._stop.set()
