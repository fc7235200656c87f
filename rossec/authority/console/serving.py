"""The console's side of `rossec ca serve`: its socket, who carries out what it asks, how the service is.

Whoever may connect can read the record's names and take rights away, so it is the authority's own
user; one other may be named, whose socket is then outside of the directory of the key.
"""

import asyncio
import contextlib
import hashlib
import logging
import os
import pwd
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final, NamedTuple

from ca.encoding import Value
from ca.errors import HintedError
from rossec import peer_limits
from rossec.authority.console import approved_acts, messages
from rossec.authority.console.access import ConsoleAccess
from rossec.authority.console.approving import ApprovalDependencies, Approving
from rossec.authority.console.grant_requests import Questions, Removals
from rossec.authority.console.messages import OPERATIONS, Status, checked, to_value
from rossec.authority.console.queries import MasterView, PolicyNames, PolicyQuery, RecordQueries, stamp
from rossec.authority.home import fingerprint
from rossec.authority.keyservice.messages import ServiceRequest
from rossec.authority.keyservice.network import NetworkWork, Scheduler
from rossec.authority.keyservice.operations import HeldKey, KeyOperations
from rossec.authority.keyservice.process import AuditedCaller, KeyServer, SocketRules
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.session import StatementCall
from rossec.errors import ConfigurationError, KeyServiceRefused, NotDelivered, PeerUserRefused
from rossec.host.local_sockets import UnixPeer

INBOX = "inbox"  # in the authority's directory (`rossec.authority.requests`)


class StatusQuery:
    """`has_master`: whether the last call to the master succeeded. `seen`: whatever else differs when
    something to be shown has changed.
    """

    def __init__(
        self,
        work: AuthorityWork,
        held: HeldKey,
        has_master: Callable[[], bool],
        seen: Callable[[], tuple[object, ...]] = tuple,
    ) -> None:
        self._work = work
        self._held = held
        self._has_master = has_master
        self._seen = seen
        anchor = work.home().anchor()
        self._domain, self._fingerprint = anchor.domain, fingerprint(anchor)

    def status(self) -> Value:
        # Asked every second, so it looks at little: sizes and times.
        home, now = self._work.home(), self._work.now()
        with contextlib.closing(home.store()) as store, store.database.read_transaction():
            size, phones = store.log.head(now).size, len(store.passkeys.active())
        remaining, has_master = self._held.remaining(), self._has_master()
        files = (self._work.policy_path(), home.path / INBOX)
        state = size, remaining is None, has_master, *map(stamp, files), *self._seen()
        number = int.from_bytes(hashlib.sha256(repr(state).encode()).digest()[:6])
        about = self._domain, self._fingerprint, remaining is None, remaining
        return to_value(Status(*about, number, now, phones, has_master))


_START: Final = 19  # of the fields after the command's name, proc(5): starttime
_LIMIT: Final = b"Max processes"


class ConsolePeers:
    # Which processes may not use `service.sock`: whoever showed itself to be the console's pages. The web
    # process can start no other one, so one that was taken over cannot ask for signatures, whether it came
    # to the console's socket first (it is remembered as long as it lives) or not (its limits show it). A
    # number is given again to another process, so its start is remembered too.

    def __init__(self, proc: Path = Path("/proc")) -> None:
        self._proc = proc
        self._lock = threading.Lock()
        self._known: dict[int, bytes | None] = {}  # when it started, by its number

    def remember(self, peer: UnixPeer) -> None:
        started = self._started(peer.process)
        with self._lock:
            for process in [each for each in self._known if self._is_gone(each)]:
                del self._known[process]
            self._known[peer.process] = started

    def refuse(self, peer: UnixPeer) -> None:
        with self._lock:
            is_refused = peer.process in self._known and not self._is_gone(peer.process)
        with contextlib.suppress(OSError):
            for line in (self._proc / str(peer.process) / "limits").read_bytes().splitlines():
                # RLIMIT_NPROC of 0 is what `confine_processes` leaves.
                if line.startswith(_LIMIT) and line.removeprefix(_LIMIT).split()[:2] == [b"0", b"0"]:
                    is_refused = True
        if is_refused:
            raise PeerUserRefused("a process of the console's pages may not use the service's socket")

    def _is_gone(self, process: int) -> bool:
        # Where it cannot be told, it is not gone: unless there is a /proc that says so.
        remembered, now = self._known[process], self._started(process)
        if now is None:
            return not (self._proc / str(process)).exists() and (self._proc / "self").exists()
        return remembered is not None and remembered != now

    def _started(self, process: int) -> bytes | None:
        try:
            stat = (self._proc / str(process) / "stat").read_bytes()
        except OSError:
            return None
        fields = stat.rpartition(b")")[2].split()  # its name may have spaces and parentheses
        return fields[_START] if len(fields) > _START else None


_log = logging.getLogger("rossec.authority.service")

Handler = Callable[..., Value]


def handlers_of(part: object) -> dict[str, Handler]:
    methods = {name: getattr(part, name.replace("-", "_"), None) for name in OPERATIONS}
    return {name: method for name, method in methods.items() if callable(method)}


class ConsoleService:
    """`parts`: which have one handler for each operation of the table between them. `audit`: writes a line.
    Raises `HintedError` if it cannot: then nothing is done.
    """

    def __init__(self, *parts: object, audit: Callable[[str], None] = lambda _: None) -> None:
        self._audit = audit
        # Each part has a thread: it needs no lock, and none waits for a master that does not answer but those
        # who ask for it.
        self._threads = [ThreadPoolExecutor(1, thread_name_prefix="console") for _ in parts]
        self._handlers: dict[str, tuple[ThreadPoolExecutor, Handler]] = {}
        for part, thread in zip(parts, self._threads, strict=True):
            for operation, handler in handlers_of(part).items():
                if operation in self._handlers:
                    raise ValueError(f"{operation} has two handlers")
                self._handlers[operation] = thread, handler

    @property
    def missing(self) -> frozenset[str]:
        return frozenset(OPERATIONS) - self._handlers.keys()

    async def carry_out(self, request: ServiceRequest, caller: AuditedCaller) -> Value:
        if request.operation not in self._handlers:
            raise KeyServiceRefused(
                f"this service does not do {request.operation}", "restart it: rossec ca serve"
            )
        if OPERATIONS[request.operation].changes:  # before it is done: without a line nothing is
            about = request.arguments[0]
            shown = about.hex() if isinstance(about, bytes) else peer_limits.printable(str(about))
            self._audit(f"{request.operation} {shown}, asked by the console of {caller}")
        thread, handler = self._handlers[request.operation]
        call = lambda: checked(handler(*request.arguments))  # noqa: E731 - in the thread, as a whole
        return await asyncio.get_running_loop().run_in_executor(thread, call)

    async def close(self) -> None:
        for thread in self._threads:
            await asyncio.to_thread(thread.shutdown, cancel_futures=True)


MAX_CALLERS: Final = 16


class ConsolePlace(NamedTuple):
    """Where the socket is, and which users may connect; none: the one of this process."""

    path: Path
    users: frozenset[int] = frozenset()


def place(directory: Path, path: Path | None, user: str | None) -> ConsolePlace:
    if path is not None and path.exists() and not path.is_socket():
        raise ConfigurationError(f"{path} is a file, and not a socket", "choose another --console-socket")
    if user is None:
        return ConsolePlace(path or directory / messages.SOCKET)
    try:
        number = pwd.getpwnam(user).pw_uid
    except KeyError:
        raise ConfigurationError(
            f"there is no user {user!a} on this host", "make one, or leave --console-user"
        ) from None
    if path is None:
        raise ConfigurationError(
            f"{user} cannot enter {directory}, where the socket would be",
            "name a directory for it: --console-socket /run/rossec/console.sock",
        )
    parent = path.parent
    try:
        found = parent.stat()
    except OSError as error:
        raise ConfigurationError(
            f"{parent}: {error.strerror}", "make it, as the user of the service"
        ) from None
    if found.st_mode & 0o022 or found.st_uid not in {0, os.geteuid()}:
        raise ConfigurationError(
            f"another user could replace the socket in {parent}",
            "choose a directory of your own, which no other user can write",
        )
    return ConsolePlace(path, frozenset({os.geteuid(), number}))


def console_server(where: ConsolePlace, service: ConsoleService, peers: ConsolePeers) -> KeyServer:
    rules = SocketRules(messages.read_request, messages.MAX_REQUEST, MAX_CALLERS, where.users)
    return KeyServer(where.path, service.carry_out, peers.remember, rules)


def _no_address() -> str:
    raise ConfigurationError(
        "this service has no join port", "start it without --no-network: rossec ca serve"
    )


DELIVERIES_KEPT: Final = 10.0  # seconds
PURPOSE: Final = "a look at the console"


class Console:
    """`network`: None: no master is called, and no node joins. `policy`: its file; None: the usual place.
    `join_address`: where nodes reach the join port, `host:port`, for join codes.
    """

    def __init__(
        self,
        where: ConsolePlace,
        rossec_home: Path,
        operations: KeyOperations,
        network: NetworkWork | None,
        policy: Path | None = None,
        join_address: Callable[[], str] = _no_address,
    ) -> None:
        self.where = where
        self.peers = ConsolePeers()
        work = network.work if network else AuthorityWork(rossec_home, operations, _fail, policy)
        self.rounds = network.rounds if network else Scheduler(asyncio.to_thread)
        operations.on_unlock = self.rounds.wake
        self.access = ConsoleAccess(work, operations.audit)
        self._network = network
        needs = ApprovalDependencies(work, operations.audit, self.rounds.wake, self.access.counter)
        self.approving = Approving(needs, approved_acts.acts_of(work, self.access, join_address))
        self.rounds.add(self.approving.carry_out_waiting, first=True)
        self.master = MasterView(work, network.deliver if network else _fail, came_back=self.rounds.wake)
        self.service = ConsoleService(
            self.access,
            StatusQuery(work, operations.held, self._has_master, self._seen),
            RecordQueries(work, self.access.last_used, Deliveries(work, self._has_master).states),
            Questions(work),
            PolicyQuery(work),
            PolicyNames(work),
            self.approving,
            self.master,
            Removals(work, self.rounds.wake),
            audit=operations.audit,
        )
        self._server = console_server(where, self.service, self.peers)

    async def start(self) -> None:
        await self._server.start()

    async def close(self) -> None:
        await self._server.close()
        await self.service.close()

    def _has_master(self) -> bool:
        return self._network is not None and self._network.has_master

    def _seen(self) -> tuple[object, ...]:
        # What the console shows and the record does not say.
        return self.master.look(), *(each.id for each in self.access.proposed.all())


class Deliveries:
    """What the master says of each grant in force; asked while it answers, and not every time."""

    def __init__(self, work: AuthorityWork, has_master: Callable[[], bool]) -> None:
        self._work = work
        self._has_master = has_master
        self._states: dict[bytes, str] = {}
        self._asked = float("-inf")

    def states(self) -> dict[bytes, str]:
        now = time.monotonic()
        if not self._has_master():
            return {}
        if now - self._asked > DELIVERIES_KEPT:
            self._asked = now
            try:
                with self._work.service(PURPOSE) as service:
                    self._states = service.grants.delivery_states()
            except HintedError:
                self._states = {}
        return self._states


def _fail(call: StatementCall) -> object:
    raise NotDelivered(f"the master did not get {call.what}: this service calls none", call.hint)
