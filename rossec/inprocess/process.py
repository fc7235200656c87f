"""What the hooks of one process share: its identity, connections and background loop.

Until the node has a name there is no identity, and no connection can be made: every hook that needs
one raises. The background loop, a thread, runs the membership of the process, whose session with the
master also carries rospy's calls.
"""

import asyncio
import contextlib
import errno
import logging
import queue
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from threading import Event, Lock, RLock, Thread
from typing import Final, TypeAlias

from ca.bounded import Newest
from ca.certificates import Identity
from ca.errors import HintedError
from grants.guard import Guard
from rossec import clock
from rossec.errors import ChannelError, ConfigurationError, PlainPeer, RossecError, XmlRpcRefused
from rossec.inprocess.identity import Connector, LocalIdentity
from rossec.inprocess.options import PlainPeers
from rossec.inprocess.sockets import RosSocket
from rossec.net.aio import SecureStream
from rossec.net.context import forget_in_children
from rossec.participant.authorized import AuthorizedConnection
from rossec.participant.connections import ConnectionTable, Dialer, FollowedPublishers, OwnAddresses
from rossec.participant.membership import Membership
from rossec.participant.registrations import REFUSED, UNREGISTERS, PublisherGrace, RegistrationTable
from rossec.peer_limits import printable
from rossec.ros import names, xmlrpc

REGISTRATIONS: Final[Mapping[str, object]] = {  # each with what a master without other nodes answers
    "registerPublisher": [],
    "registerSubscriber": [],
    "registerService": 1,
}
_NODES: Final = 1024  # that were looked up
REMEMBERED: Final = 512
_BURST: Final = 30  # lines within PERIOD; unauthenticated peers must not fill a disk
_SHARE: Final = 10  # of them about one peer, topic or address
_FIRST: Final = 60  # beyond the burst: only the first line about each subject
_PERIOD: Final = 10.0
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
RosConnection: TypeAlias = AuthorizedConnection[RosSocket, Guard | None]
_NAMELESS: Final = (
    "call rospy.init_node first, or give the name it will have:"
    " rossec.secure('name'), or __name:=name on the command line"
)


class Registrations:
    """What the master answered rospy; thread-safe.

    A registration that the master refused is repeated when there is a new grant.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self.table = RegistrationTable()  # what is registered, or was refused
        self.publishers = PublisherGrace(now)  # those that the master names, by topic
        self._nodes: Newest[tuple[str, int], None] = Newest(_NODES)

    def record(self, method: str, params: Sequence[object], answer: object) -> None:
        if method in UNREGISTERS:  # whatever the answer: the program is done with it
            self.table.record(method, params)
        match answer:
            case [1, _, value]:
                self.table.record(method, params)
                if method == "registerSubscriber":
                    self.set_publishers(str(params[1]), value)
                elif method == "lookupNode" and isinstance(value, str):
                    with suppress(ConfigurationError):
                        self._nodes[names.parse_uri(value)] = None
            case [_, str(status), _] if status.startswith(REFUSED):
                self.table.record(method, params, refused=True)
            case _:
                pass

    def set_publishers(self, topic: str, uris: object) -> None:
        if isinstance(uris, Iterable):
            self.publishers.update(topic, [uri for uri in uris if isinstance(uri, str)])

    def is_publisher(self, topic: str, uri: str) -> bool:
        return uri in self.publishers.to_follow(topic)

    def is_node(self, address: tuple[str, int]) -> bool:
        return address in self._nodes


class CallReporter:
    """Warnings for the developer: one for each cause, not for each retry, by a thread of its own."""

    def __init__(self, write: Callable[[str], None]) -> None:
        self._write = write
        self._reported: Newest[str, None] = Newest(REMEMBERED)
        self._since, self._counts, self._suppressed = 0.0, Counter[str](), False
        self.abandon()
        forget_in_children(self)

    def abandon(self) -> None:
        self._lock = Lock()
        self._queue: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._thread: Thread | None = None

    def warn(self, what: str, why: Exception | None = None) -> None:
        # The subject of the line is the text before the first colon of `what`.
        text = what if why is None else f"{what}: {why}"
        hint = why.hint if isinstance(why, HintedError) else ""
        line = f"rossec: {printable(text)}" + (f" (hint: {printable(hint)})" if hint else "")
        with self._lock:
            if line in self._reported:
                return
            self._reported[line] = None
            # No peer may suppress the lines about others, nor fill the disk: a share for each subject.
            subject, moment = what.partition(":")[0], time.monotonic()
            if moment - self._since > _PERIOD:
                self._since, self._counts, self._suppressed = moment, Counter(), False
            most = _BURST if self._counts[subject] else _FIRST
            if self._counts[subject] < _SHARE and self._counts.total() < most:
                self._counts[subject] += 1
                self._put(line)
            elif not self._suppressed:
                self._put("rossec: too many different warnings; some are suppressed")
                self._suppressed = True

    def _put(self, line: str) -> None:
        # `rospy.logwarn` publishes on /rosout and asks the master for a parameter: it must never be called by
        # the thread that speaks to the master, nor with a lock held.
        if self._thread is None:
            self._thread = Thread(target=self._run, name="rossec report", daemon=True)
            self._thread.start()
        self._queue.put(line)

    def forget(self, what: str) -> None:
        # `what` has succeeded since: if it fails again, it is logged again.
        with self._lock:
            for line in [line for line in self._reported if line.startswith(f"rossec: {what}")]:
                del self._reported[line]

    def close(self) -> None:
        with self._lock:
            thread, self._thread = self._thread, None
        if thread is not None:
            self._queue.put(None)
            thread.join(timeout=1.0)

    def _run(self) -> None:
        lines = self._queue
        while (line := lines.get()) is not None:
            with suppress(Exception):  # a handler of the program may raise
                self._write(line)


class LogBridge(logging.Handler):
    def __init__(self, reporter: CallReporter) -> None:
        super().__init__(logging.WARNING)
        self._reporter = reporter

    def emit(self, record: logging.LogRecord) -> None:
        self._reporter.warn(record.getMessage())


class BackgroundLoop:
    def __init__(
        self, local_identity: LocalIdentity, registrations: Registrations, master: tuple[str, int]
    ) -> None:
        self._local_identity, self._registrations = local_identity, registrations
        self.address = master
        self._loop = asyncio.new_event_loop()
        self._ready = asyncio.Event()
        self._stop = asyncio.Event()
        self._first_attempt = Event()
        access = local_identity.access
        self._dialer = Dialer(local_identity.name, local_identity.live_context, access.check_peer)
        self.connections: ConnectionTable[RosSocket] = ConnectionTable(
            local_identity.trust_status, access.lock, PEER_CONNECTIONS, local_identity.master
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
        self._thread.start()
        self._first_attempt.wait(_FIRST_WAIT)

    def stop(self) -> None:
        if self._thread.is_alive():
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join(timeout=_RECONNECT_WAIT)

    def call(self, method: str, params: tuple[object, ...]) -> object:
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
                raise xmlrpc.Fault(xmlrpc.FAULT_CODE, str(error)) from None
            text = str(error) or "no answer from the master"
            raise ConnectionRefusedError(errno.ECONNREFUSED, f"rossec: {text}") from error

    # -- in the loop

    def _run(self) -> None:
        async def main() -> None:
            self.membership.start(self._open_session)
            self.membership.tasks.spawn(self._run_timers(), "timers of idle connections")
            self.membership.tasks.spawn(self.followed.leave_regularly(), "publishers to leave")
            await self._stop.wait()
            await self.membership.close()

        try:
            with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
                runner.run(main())  # its end cancels the calls that wait
        finally:
            self._first_attempt.set()

    async def _open_session(self) -> None:
        try:
            await self.membership.session.open()
        except (HintedError, OSError, xmlrpc.Fault) as error:
            _log.warning("%s: no answer from the master: %s", self._local_identity.name, error)
        self._first_attempt.set()

    async def _run_timers(self) -> None:
        while True:
            await asyncio.sleep(_TIMERS_PERIOD)
            for connection in self.connections:
                connection.stream.run_timers()

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
        self._ready.clear()
        return await self._dialer.rpc(*self.address)

    async def dial_watch(self) -> SecureStream[Identity]:
        return await self._dialer.rpc(*self.address)

    async def restore(self) -> None:
        for method, params in self._registrations.table:
            await self._register(method, params)
        self._ready.set()

    async def rights_changed(self) -> None:
        for method, params in self._registrations.table.refused():
            await self._register(method, params)

    def maintain(self) -> None:
        name = self._local_identity.name
        try:
            if self._local_identity.refresh_identity():
                _log.info("%s: uses a new certificate", name)
        except (HintedError, OSError) as error:
            _log.warning("%s: the identity in its directory is invalid: %s", name, error)

    def crashed(self, error: BaseException) -> None:
        _log.error("the background loop failed, all connections are closed: %s", error)
        self.connections.close("the background loop failed")  # no right would end one any more
        # It unregisters this node at the master, which must not happen in the thread of this loop.
        Thread(target=self.on_crash, name="rossec end", daemon=True).start()
        self._stop.set()


class SecuredProcess:
    def __init__(self, reporter: CallReporter, plain: PlainPeers = PlainPeers()) -> None:  # noqa: B008 - constant
        self.reporter, self.plain = reporter, plain
        self.own_addresses = OwnAddresses()
        self._begun: tuple[LocalIdentity, Connector, Registrations, BackgroundLoop] | None = None
        self._begin_lock = RLock()
        self.begin_early: Callable[[], None] = lambda: None  # `begin`, if the node's name is known

    def begin(self, local_identity: LocalIdentity, master: tuple[str, int]) -> None:
        connector = Connector(local_identity, self.own_addresses)
        registrations = Registrations(clock.counter())
        background_loop = BackgroundLoop(local_identity, registrations, master)
        self._begun = local_identity, connector, registrations, background_loop
        background_loop.start()

    @property
    def has_begun(self) -> bool:
        return self._begun is not None

    def require_begun(self) -> tuple[LocalIdentity, Connector, Registrations, BackgroundLoop]:
        """What exists once the node has a name; raises `ConfigurationError` while it has none."""
        # A call before `rospy.init_node` uses the name that the node will have, if that is known.
        if self._begun is None:
            with self._begin_lock:
                if self._begun is None:
                    self.begin_early()
        if self._begun is None:
            error = ConfigurationError("this program has no name yet", _NAMELESS)
            error.add_note(f"hint: {error.hint}")
            raise error
        return self._begun

    @property
    def local_identity(self) -> LocalIdentity:
        return self.require_begun()[0]

    @property
    def connector(self) -> Connector:
        return self.require_begun()[1]

    @property
    def registrations(self) -> Registrations:
        return self.require_begun()[2]

    @property
    def background_loop(self) -> BackgroundLoop:
        return self.require_begun()[3]

    @property
    def membership(self) -> Membership:
        return self.background_loop.membership

    @property
    def connections(self) -> ConnectionTable[RosSocket]:
        return self.background_loop.connections

    # -- connections

    def listens(self, port: int, host: str | None = None) -> None:
        self.own_addresses.add_ports(self.own_addresses.host if host is None else host, port)

    def add_connection(self, sock: RosSocket, connection: RosConnection) -> None:
        sock.connection = connection
        self.connections.add(connection)

    def follows(self, sock: RosSocket, topic: str, publisher: str) -> None:
        self.background_loop.followed.add(sock, topic, publisher)

    def connection_closed(self, sock: RosSocket) -> None:
        if self.has_begun:
            self.connections.forget(sock)
            self.background_loop.followed.discard(sock)
        if isinstance(sock.connection, AuthorizedConnection):
            self.connections.discard(sock.connection)

    def allows_plain(self, name: str, address: str) -> bool:
        # Whether `allow_plain` names this; if so, a warning is logged.
        allowed = self.plain.allows(name, address)
        if allowed:
            self.reporter.warn(f"PLAIN: {name} with {address}, neither encrypted nor checked")
        return allowed

    def connect_error(self, address: tuple[str, int], error: ChannelError) -> Exception:
        self.reporter.warn(f"cannot connect to {address[0]} port {address[1]}", error)
        if isinstance(error, PlainPeer):  # rospy does not try again
            return ConnectionError(f"rossec: {error}")
        return ConnectionAbortedError(errno.ECONNABORTED, f"rossec: {error}")  # rospy tries again
