"""What the service does at the network: joins, rounds, identities that nodes renew. A shell.

Tasks that need the record run in one thread, one after the other; a round, every minute and at once
when there is a reason, is a task as a join is.
"""

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final, Self, TypeVar

from ca.encoding import Value
from ca.enrollment.invitation import JoinClaim, JoinRequest
from ca.enrollment.join import NameAnswer, Named, RefusedMessage, RefuseReason, write
from ca.errors import EncodingError, HintedError
from ca.names import is_reserved, pattern_covers
from rossec.authority.keyservice.operations import KeyOperations
from rossec.authority.keyservice.process import FrontEndProcess
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.session import StatementCall
from rossec.errors import ConfigurationError, NotDelivered, RossecError
from rossec.host.runner import TaskSet
from rossec.naming import RuleRunner
from rossec.peer_limits import printable
from rossec.ros.names import SETTLE_RENEWALS, WATCH_RENEWALS

ROUND: Final = 60.0  # seconds between two rounds
_log = logging.getLogger("rossec.authority.service")

Task = Callable[[], None]


class Scheduler:
    """`in_thread`: calls a task in a thread."""

    def __init__(self, in_thread: Callable[[Task], Awaitable[None]]) -> None:
        self._in_thread = in_thread
        self._tasks: list[Task] = []
        self._due = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None

    def add(self, task: Task, *, first: bool = False) -> None:
        self._tasks.insert(0 if first else len(self._tasks), task)

    def wake(self) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._due.set)

    async def run(self) -> None:
        self._loop = asyncio.get_running_loop()
        while True:
            self._due.clear()
            for task in self._tasks:
                try:
                    await self._in_thread(task)
                except Exception:  # noqa: BLE001 - without the next, revocations would stay behind
                    _log.exception("a round of the authority failed")
            try:
                async with asyncio.timeout(ROUND):
                    await self._due.wait()
            except TimeoutError:
                continue


CHILDREN: Final = 2
SECONDS: Final = 1.0  # for one answer of the rules


class JoinNames:
    def __init__(self, rules: bytes | None) -> None:
        self._runner = None if rules is None else RuleRunner(rules, children=CHILDREN, seconds=SECONDS)

    async def __aenter__(self) -> Self:
        if self._runner is not None:
            await self._runner.__aenter__()
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._runner is not None:
            self._runner.close()

    async def answer(self, metadata: bytes, pattern: str) -> NameAnswer:
        # For the claim, and again for the request that follows it, since what is between may lie. Metadata of
        # strangers are never read here, where the key is: they go to the confined process for rules.
        if self._runner is None:
            return RefusedMessage(RefuseReason.UNNAMED)
        try:
            name = await self._runner.name(metadata)
        except RossecError as error:
            _log.warning("a node that joins has no name: %s", printable(error))
            return RefusedMessage(RefuseReason.METADATA)
        if is_reserved(name) or not pattern_covers(pattern, name):
            return RefusedMessage(RefuseReason.NAME)
        return Named(name)


WITHIN: Final = 40  # seconds for a call that waits at the master
SETTLE_WITHIN: Final = 15
LOCKED_PAUSE: Final = 10.0  # seconds until a locked service looks again
FIRST_PAUSE: Final = 1.0  # seconds after a failure, doubled up to
LONGEST_PAUSE: Final = 30.0
QUIET: Final = 60.0  # seconds out of reach until it is said: it may start after the service

Renew = Callable[[list[bytes]], Awaitable[list[tuple[bytes, bytes, str]]]]


class RenewalWatch:
    """Renews identities: waits at the master for requests, so that a node has its new one in seconds.

    While the key is locked it says so there, since nodes tell their users, and does not wait.

    `work`: says whether the key is held. `renew`: answers requests, in the thread of the work.
    """

    def __init__(self, face: FrontEndProcess, work: AuthorityWork, renew: Renew) -> None:
        self._face = face
        self._work = work
        self._renew = renew
        self._looks_again = asyncio.Event()
        self._said = ""

    def wake(self) -> None:
        self._looks_again.set()

    async def run(self) -> None:
        pause, reached = FIRST_PAUSE, time.monotonic()
        while True:
            self._looks_again.clear()
            locked, began = self._work.is_locked, time.monotonic()
            try:
                found = await self._look(locked=locked)
            except Exception as error:  # noqa: BLE001 - a crash must not end all renewals
                if not isinstance(error, HintedError | OSError):  # a TimeoutError is one
                    _log.exception("renewing identities failed")
                if time.monotonic() - reached >= QUIET:
                    cause = printable(error) or "no answer in time"
                    self._say(f"no identities are renewed: {cause}")
                await self._wait(pause)
                pause = min(2 * pause, LONGEST_PAUSE)
                continue
            pause, reached = FIRST_PAUSE, time.monotonic()
            if locked:
                await self._wait(LOCKED_PAUSE)
            elif found:
                self._said = ""
            elif time.monotonic() - began < FIRST_PAUSE:  # it should have waited
                await self._wait(FIRST_PAUSE)

    async def _look(self, *, locked: bool) -> int:
        answer = await self._face.call(WATCH_RENEWALS, [int(locked)], WITHIN)
        match answer:
            case {"renewals": list() as items, "waiting": int() as waiting}:
                requests = [item for item in items if isinstance(item, bytes)]
            case _:
                requests, waiting = [], 0
        if locked and waiting:
            self._say(
                f"{waiting} {'node waits' if waiting == 1 else 'nodes wait'} for a new identity,"
                " and the key is locked: rossec ca unlock --for 8h"
            )
        if not requests:
            return 0
        answers = await self._renew(requests)
        settled: list[Value] = [[digest, bundle, reason] for digest, bundle, reason in answers]
        if settled:
            await self._face.call(SETTLE_RENEWALS, [settled], SETTLE_WITHIN)
        return len(settled)

    async def _wait(self, seconds: float) -> None:
        try:
            async with asyncio.timeout(seconds):
                await self._looks_again.wait()
        except TimeoutError:
            return

    def _say(self, text: str) -> None:
        if text != self._said:
            _log.warning("%s", text)
        self._said = text


_WITHIN: Final = 30.0  # seconds for a call at the master that does not say
SLOW: Final = 1.0  # seconds in which a master that runs, or does not, has answered
PAUSE: Final = 45.0  # seconds without calls after one that failed slowly; less than a round
_OTHER_NAME: Final = RefusedMessage(RefuseReason.NAME)
_T = TypeVar("_T")


class NetworkWork:
    """What the network asks of the service, and it of the network.

    `applies`: put the policy in force in every round; a node that joins gets its grants anyhow.
    `policy`: its file; None: the usual place. `rules`: by which nodes that join are named; None:
    none is. `renews`: renew identities of nodes that ask for it at the master.
    """

    def __init__(
        self,
        rossec_home: Path,
        operations: KeyOperations,
        face: FrontEndProcess,
        *,
        applies: bool = False,
        policy: Path | None = None,
        rules: bytes | None = None,
        renews: bool = True,
    ) -> None:
        self._names = JoinNames(rules)
        self._face = face
        self._applies = applies
        self.work = AuthorityWork(rossec_home, operations, self.deliver, policy)
        self.rounds = Scheduler(self._in_thread)
        self.rounds.add(self.work.maintain)
        if applies:
            self.rounds.add(self.work.apply_if_changed)
        self._renewals = RenewalWatch(face, self.work, self._renew) if renews else None
        self.has_master = False  # whether the last call succeeded
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="authority")
        self._tasks = TaskSet()
        self._joined: list[str] = []  # names that have no grants yet
        self._giving = asyncio.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._resume = 0.0

    def deliver(self, call: StatementCall) -> Value:
        if self._loop is None:
            raise NotDelivered(f"the master did not get {call.what}: not started", call.hint)
        began = time.monotonic()
        if began < self._resume:
            raise NotDelivered(f"the master did not get {call.what}: it is out of reach", call.hint)
        within = int(call.within or _WITHIN)
        arguments: list[Value] = list(map(_as_value, call.statement))
        asked = self._face.call(call.method, arguments, within)
        try:
            answer = asyncio.run_coroutine_threadsafe(asked, self._loop).result()
        except (HintedError, TimeoutError) as error:
            self.has_master = False
            # A master whose host is off fails slowly, and all tasks share one thread.
            if time.monotonic() - began > SLOW and not call.waits:
                self._resume = time.monotonic() + PAUSE
            reason = str(error) or "no answer in time"
            what = f"the master did not get {call.what}: {reason}"
            raise NotDelivered(what, call.hint) from error
        self.has_master = True
        return answer

    async def run(self) -> None:
        self._loop = asyncio.get_running_loop()
        async with self._names:  # first of all: rules that are refused end it
            self._tasks.spawn(self._rounds(), name="rounds of the authority")
            try:
                await self._face.run(self._join, self._name)
            finally:
                await self._tasks.close()
                await asyncio.to_thread(self._thread.shutdown, cancel_futures=True)

    async def _name(self, data: bytes) -> Value:
        return write(await self._named(JoinClaim.from_bytes(data)))

    async def _named(self, asked: JoinClaim | JoinRequest) -> NameAnswer:
        # The name for the metadata in there, which are looked at by the process for rules only.
        # 1. Only when the secret of an invitation was proved.
        pattern = await self._in_thread(self.work.allowed_pattern, asked)
        if isinstance(pattern, RefusedMessage):
            return pattern
        # 2. The name, which must be within what that invitation allows.
        return await self._names.answer(asked.metadata, pattern)

    async def _join(self, data: bytes) -> Value:
        request = JoinRequest.from_bytes(data)
        # One that was issued gets its answer again, whatever the rules say meanwhile.
        if request.metadata and not await self._in_thread(self.work.was_issued, request):
            named = await self._named(request)
            if named != Named(request.name):
                return write(named if isinstance(named, RefusedMessage) else _OTHER_NAME)
        answer, name = await self._in_thread(self.work.join, data)
        if name is not None:
            self._joined.append(name)
            self._tasks.spawn(self._give_to_joined(), name="grants of nodes that joined")
        return answer

    async def _give_to_joined(self) -> None:
        give = self.work.apply if self._applies else self.work.grant_outright
        async with self._giving:  # nodes that join meanwhile are all given theirs by the next
            names, self._joined = self._joined, []
            if names:
                await self._in_thread(give, names)

    async def _rounds(self) -> None:
        try:
            await self._face.started()
        except ConfigurationError:
            return  # `rossec ca serve` reports it, and ends
        if self._renewals is not None and not self.work.home().is_intermediate:
            loop, wake = asyncio.get_running_loop(), self._renewals.wake

            def look_again() -> None:  # called in the thread of the work
                loop.call_soon_threadsafe(wake)

            self.rounds.add(look_again)
            self._tasks.spawn(self._renewals.run(), name="identities that nodes renew")
        await self.rounds.run()

    async def _renew(self, requests: list[bytes]) -> list[tuple[bytes, bytes, str]]:
        return await self._in_thread(self.work.renew_identities, requests)

    async def _in_thread(self, task: Callable[..., _T], *arguments: object) -> _T:
        return await asyncio.get_running_loop().run_in_executor(self._thread, task, *arguments)


def _as_value(item: object) -> Value:
    match item:
        case bytes() | str() | int():
            return item
        case list():
            return [_as_value(each) for each in item]
        case _:
            raise EncodingError("an argument of a call that is no plain value")
