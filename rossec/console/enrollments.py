"""The nodes that are being added: from the code that a person brought to the node's own last word. A shell.

An enrollment is one code; its secret stays here, in the web process, and all of them end with it: their nodes
show a new code. The states are those that a page shows; the protocol is `ca.enrollment.sides`, over sockets
in `rossec.enrollment.enroll`.
"""

import asyncio
import secrets
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Any, Final, NamedTuple, Protocol

from ca.certificates import from_pem
from ca.enrollment import NONCE_SIZE, WINDOW, qr
from ca.enrollment.sides import AuthorityEnrollment, AuthorityState
from ca.errors import CodeRefused, EnrollmentExpired, EnrollmentOver, HintedError, RequestSwapped
from rossec.authority.console import messages
from rossec.enrollment import deliver, fetch
from rossec.errors import KeyServiceFailed, RossecError
from rossec.host import addresses
from rossec.host.runner import TaskSet
from rossec.peer_limits import SharedTable

REJECTED: Final = "rejected at the console"
DIFFERED: Final = "the digits differed"
DONE, WAITING = "done", "waiting"  # states of an outcome
POLL: Final = 1.0  # seconds
_PATIENCE: Final = 3600  # seconds that a label waits for the key; a screen code ends sooner


class Stage(Enum):
    FETCHING = "fetching"
    COMPARED = "compared"  # a person decides
    WAITING = "waiting"  # approved; the key is locked
    DELIVERING = "delivering"
    DIGITS = "digits"  # a person compares, and confirms at the node
    ENROLLED = "enrolled"
    REJECTED = "rejected"
    DIFFERED = "differed"  # the digits: somebody is in between
    SWAPPED = "swapped"  # the request is not the code's
    FAILED = "failed"


OVER: Final = frozenset({Stage.ENROLLED, Stage.REJECTED, Stage.DIFFERED, Stage.SWAPPED, Stage.FAILED})


class RecordedName(Enum):
    NEW = "new"
    SAME_KEY = "same key"
    OTHER_KEY = "other key"


class Destination(NamedTuple):
    host: str
    port: int
    kind: str


class EnrollmentService(Protocol):
    async def nodes(self) -> tuple[messages.NodeView, ...]: ...

    async def identity_requests(self) -> tuple[messages.IdentityRequestView, ...]: ...

    async def deny_request(self, request: bytes, reason: str) -> None: ...

    async def revoke_node(self, name: str, reason: str) -> tuple[int, int]: ...

    async def outcome(self, statement: bytes, /) -> messages.ApprovalOutcome: ...


class Enrollment:
    def __init__(
        self,
        core: AuthorityEnrollment,
        destination: Destination,
        service: EnrollmentService,
        clock: Callable[[], int],
        changed: Callable[[], None],
    ) -> None:
        self.core = core
        self.stage = Stage.FETCHING  # what the page shows
        self.known = RecordedName.NEW  # of meaning from COMPARED on
        self.error: HintedError | None = None
        self._destination, self._service = destination, service
        self._clock, self._changed, self._begun = clock, changed, clock()

    @property
    def is_over(self) -> bool:
        return self.stage in OVER

    @property
    def source(self) -> str:
        host, port, kind = self._destination
        return f"{kind} at {addresses.join(host, port)}"

    @property
    def is_other_key(self) -> bool:
        # Whether the name has another key by now, which would be revoked.
        return self.known is RecordedName.OTHER_KEY

    @property
    def deadline(self) -> int:
        return self.core.deadline or self._begun + _PATIENCE

    def check_can_approve(self) -> None:
        if self.stage is Stage.COMPARED:
            self._end_if_late()
        if self.stage is not Stage.COMPARED:
            said = f"this node is not to be decided on: {self.stage.value}"
            raise EnrollmentOver(said, "load the page anew")

    def check_time(self) -> None:
        # End it if a person decides too late, so that its page says so.
        if self.stage is Stage.COMPARED:
            try:
                self._end_if_late()
            except EnrollmentExpired as error:
                self.fail(error)

    async def fetch(self) -> None:
        try:
            host, port, _ = self._destination
            await fetch(self.core, host, port, self._clock)
            nodes = await self._service.nodes()
            request, now = self.core.request, self._clock()
            named = [each for each in nodes if each.name == request.name and not each.revoked_at]
            if any(each.key == request.thumbprint for each in named):
                self.known = RecordedName.SAME_KEY
            if any(each.key != request.thumbprint and each.not_after > now for each in named):
                self.known = RecordedName.OTHER_KEY
            self._move(Stage.COMPARED)
        except HintedError as error:
            self.fail(error)

    def approve(self, outcome: messages.ApprovalOutcome) -> None:
        self._move(Stage.WAITING if outcome.state == WAITING else Stage.DELIVERING)

    async def deliver(self, outcome: messages.ApprovalOutcome) -> None:
        try:
            self.core.approve(self._clock())
            # Nothing is signed here: an approval is the service's, which returns the identity.
            bundle = await self._signed(outcome)
            *chain, root = from_pem(bundle)
            offer = self.core.offer(chain, root, secrets.token_bytes(NONCE_SIZE), self._clock())
            self._move(Stage.DELIVERING)
            host, port, _ = self._destination
            async with asyncio.timeout(2 * WINDOW):
                # It returns when the node has said that it is enrolled, and not before.
                await deliver(self.core, offer, host, port, self._clock, lambda _: self._move(Stage.DIGITS))
            self._move(Stage.ENROLLED)
        except HintedError as error:
            self.fail(error)
        except TimeoutError:
            self.fail(EnrollmentExpired("the node did not answer in time", "look at the node"))

    async def reject(self) -> None:
        # A person has rejected it: the record says so too, if the request got there.
        if self.stage is not Stage.COMPARED:
            raise EnrollmentOver("this node is not to be decided on", "load the page anew")
        self.core.deny()
        self._move(Stage.REJECTED)
        for each in await self._service.identity_requests():
            if each.csr == self.core.csr:
                await self._service.deny_request(each.id, REJECTED)

    def check_has_digits(self) -> None:
        if self.stage not in {Stage.DIGITS, Stage.ENROLLED}:
            raise EnrollmentOver("there are no digits to compare here", "load the page anew")

    async def differ(self) -> None:
        # The code may have been another's, and its key has an identity now. A key that was known under this
        # name before got no more than it had, and keeps that. If the revocation is refused, `error` says so.
        self.check_has_digits()
        self.core.state = AuthorityState.OVER
        self._move(Stage.DIFFERED)
        if self.known is RecordedName.SAME_KEY:
            return
        try:
            await self._service.revoke_node(self.core.request.name, DIFFERED)
        except HintedError as error:
            self.error = error.bare()
            self._changed()

    def fail(self, error: HintedError) -> None:
        self.core.state = AuthorityState.OVER
        self.error = error.bare()
        self._move(Stage.SWAPPED if isinstance(error, RequestSwapped) else Stage.FAILED)

    async def _signed(self, outcome: messages.ApprovalOutcome) -> bytes:
        while outcome.state == WAITING:
            self._end_if_late()
            await asyncio.sleep(POLL)
            try:
                outcome = await self._service.outcome(outcome.id)
            except KeyServiceFailed:  # it is started again; the record has the approval
                continue
        if outcome.state != DONE or not outcome.data:
            raise EnrollmentOver(
                f"the authority did not sign it: {outcome.result or outcome.state}",
                "correct that, have the node show a new code, and scan it again",
            )
        return outcome.data

    def _end_if_late(self) -> None:
        if self._clock() > self.deadline:
            raise EnrollmentExpired(
                "the node waits no longer: its code has expired",
                "have it show a new one (rossec node enroll NAME), and scan that",
            )

    def _move(self, stage: Stage) -> None:
        self.stage = stage
        self._changed()


MAX_RUNNING: Final = 8
MAX_KEPT: Final = 32
_APPROVED: Final = 2  # the rank of what a phone has approved, above all that begins
_AGAIN: Final = "show a new code on the node, and scan it"


@dataclass
class _Place:
    number: str
    found: Enrollment
    owner: str
    task: asyncio.Task[Any] | None = None


class Enrollments:
    """Every enrollment of one console: a bounded table of tasks."""

    # Where all places are taken, what a session that may only look has begun makes room for a phone's, and
    # nothing that was approved makes room.

    def __init__(
        self, service: EnrollmentService, domain: str, clock: Callable[[], int], changed: Callable[[], None]
    ) -> None:
        self._service, self._domain = service, domain
        self._clock, self._changed = clock, changed
        self._running: SharedTable[str, _Place] = SharedTable(MAX_RUNNING)
        self._ended: SharedTable[str, _Place] = SharedTable(MAX_KEPT)
        self._tasks = TaskSet()

    def __len__(self) -> int:
        # How many have not ended.
        return sum(not place.found.is_over for _, place in self._running.items())

    def begin(self, text: str, given_address: str = "", owner: str = messages.LOOKER) -> str:
        # `owner`: whose it is (`rossec.authority.console.messages`).
        # 1. The code, and where its node is: a label does not say it.
        code = qr.parse(text)
        code.check_time(self._clock())
        if not code.address and not given_address:
            raise CodeRefused(
                "this code is a label: it does not say where its node is",
                "type the address that the node shows, for example 192.168.1.7",
            )
        host, port = addresses.split(code.address or given_address)
        destination = Destination(host, port, "a screen" if code.secret else "a label")
        # 2. What has ended by now gives its place up before anything that runs is asked to.
        for number, place in self._running.items():
            place.found.check_time()
            if place.found.is_over:
                self._running.pop(number)
                self._keep(place)
        # 3. A place, or none.
        core = AuthorityEnrollment(code, self._domain, wildcard=True)
        found = Enrollment(core, destination, self._service, self._clock, self._changed)
        number = secrets.token_hex(16)
        place = _Place(number, found, owner)
        ended = None
        own = sum(each.owner == owner for _, each in self._running.items())
        if own < MAX_RUNNING:  # nobody ends all of their own by beginning more
            ended = self._running.add(number, place, owner, messages.rank(owner))
        if ended is None:
            said = f"{MAX_RUNNING} nodes are being added already"
            raise RossecError(said, "finish or reject one of them")
        for each in ended:  # its page says why
            each.found.fail(EnrollmentOver("its place was needed for another node", _AGAIN))
            if each.task is not None:
                each.task.cancel()
            self._keep(each)
        self._spawn(place, found.fetch)
        return number

    def get(self, number: str) -> Enrollment:
        return self._place(number).found

    def approved(self, number: str, outcome: messages.ApprovalOutcome) -> None:
        place = self._place(number)
        if place.found.stage is Stage.COMPARED:
            place.found.approve(outcome)
            self._running.add(number, place, place.owner, _APPROVED)
            self._spawn(place, partial(place.found.deliver, outcome))

    async def differ(self, number: str) -> None:
        place = self._place(number)
        place.found.check_has_digits()
        if place.task is not None:
            place.task.cancel()
        await place.found.differ()

    async def close(self) -> None:
        await self._tasks.close()

    def _place(self, number: str) -> _Place:
        place = self._running.get(number) or self._ended.get(number)
        if place is None:
            raise RossecError("this console adds no such node, or no longer", _AGAIN)
        return place

    def _spawn(self, place: _Place, work: Callable[[], Coroutine[None, None, None]]) -> None:
        # Run a step; a page never waits for one that crashed.

        async def run() -> None:
            try:
                await work()
            except Exception:
                place.found.fail(EnrollmentOver("the console has failed at this", _AGAIN))
                raise

        place.task = self._tasks.spawn(run(), name="an enrollment of the console")

    def _keep(self, place: _Place) -> None:
        self._ended.add(place.number, place, place.owner, messages.rank(place.owner))
