"""The service's joins, calls at the master and rounds: face and work put together. A shell.

Tasks that need the record run in one thread, one after the other; a round is a task as a join is.
So a master whose host is off, which fails slowly, is not called for a while: nodes go on joining.
"""

import asyncio
import logging
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final, TypeVar

from ca.encoding import Value
from ca.enrollment.join_claim import JoinClaim
from ca.enrollment.join_messages import NameAnswer, Named, Refused, RefuseReason, write
from ca.enrollment.join_request import JoinRequest
from ca.errors import EncodingError, HintedError
from rossec.authority.keyservice.face_process import FaceProcess
from rossec.authority.keyservice.join_names import JoinNames
from rossec.authority.keyservice.operations import KeyOperations
from rossec.authority.keyservice.renewal_watch import RenewalWatch
from rossec.authority.keyservice.rounds import Rounds
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.master_call import MasterCall
from rossec.errors import ConfigurationError, NotDelivered
from rossec.net.aio.tasks import TaskSet

_WITHIN: Final = 30.0  # seconds for a call at the master that does not say
SLOW: Final = 1.0  # seconds in which a master that runs, or does not, has answered
PAUSE: Final = 45.0  # seconds without calls after one that failed slowly; less than a round
_OTHER_NAME: Final = Refused(RefuseReason.NAME)
_T = TypeVar("_T")
_log = logging.getLogger("rossec.authority.service")


class NetworkWork:
    """What the network asks of the service, and it of the network.

    Args:
        rossec_home: ROSSEC_HOME.
        operations: of the key.
        face: the network face.
        applies: put the policy in force in every round; a node that joins gets its grants anyhow.
        policy: its file; None: the usual place.
        rules: by which nodes that join are named; None: none is.
        renews: renew identities of nodes that ask for it at the master.
    """

    def __init__(
        self,
        rossec_home: Path,
        operations: KeyOperations,
        face: FaceProcess,
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
        self.rounds = Rounds(self._in_thread)
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

    def deliver(self, call: MasterCall) -> Value:
        """Call the master through the face; for the thread of the work.

        Raises:
            NotDelivered: it is out of reach, or refuses.
        """
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
            if time.monotonic() - began > SLOW and not call.waits:
                self._resume = time.monotonic() + PAUSE
            reason = str(error) or "no answer in time"
            what = f"the master did not get {call.what}: {reason}"
            raise NotDelivered(what, call.hint) from error
        self.has_master = True
        return answer

    async def run(self) -> None:
        """Serve until this is cancelled."""
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
        """The name for the metadata in there, which are looked at by the process for rules only."""
        pattern = await self._in_thread(self.work.allowed_pattern, asked)
        if isinstance(pattern, Refused):
            return pattern
        return await self._names.answer(asked.metadata, pattern)

    async def _join(self, data: bytes) -> Value:
        request = JoinRequest.from_bytes(data)
        # One that was issued gets its answer again, whatever the rules say meanwhile.
        if request.metadata and not await self._in_thread(self.work.was_issued, request):
            named = await self._named(request)
            if named != Named(request.name):
                return write(named if isinstance(named, Refused) else _OTHER_NAME)
        answer, name = await self._in_thread(self.work.join, data)
        if name is not None:
            self._joined.append(name)
            self._tasks.spawn(self._give_to_joined(), name="grants of nodes that joined")
        return answer

    async def _give_to_joined(self) -> None:
        """For all that joined meanwhile at once: the policy is read once, and one call delivers."""
        give = self.work.apply if self._applies else self.work.grant_outright
        async with self._giving:
            names, self._joined = self._joined, []
            if names:
                await self._in_thread(give, names)

    async def _rounds(self) -> None:
        try:
            await self._face.started()
        except ConfigurationError:
            return  # `rossec ca serve` reports it, and ends
        if self._renewals is not None and not self.work.home().is_intermediate:
            self.rounds.add(self._renewals_again)
            self._tasks.spawn(self._renewals.run(), name="identities that nodes renew")
        await self.rounds.run()

    def _renewals_again(self) -> None:
        """In the thread of the work: a round begins when the key was unlocked."""
        if self._loop is not None and self._renewals is not None:
            self._loop.call_soon_threadsafe(self._renewals.wake)

    async def _renew(self, requests: list[bytes]) -> list[tuple[bytes, bytes, str]]:
        return await self._in_thread(self.work.renew_identities, requests)

    async def _in_thread(self, task: Callable[..., _T], *arguments: object) -> _T:
        return await asyncio.get_running_loop().run_in_executor(self._thread, task, *arguments)


def _as_value(item: object) -> Value:
    """An argument of a call: a plain value, or a list of such.

    Raises:
        EncodingError: of another type.
    """
    match item:
        case bytes() | str() | int():
            return item
        case list():
            return [_as_value(each) for each in item]
        case _:
            raise EncodingError("an argument of a call that is no plain value")
