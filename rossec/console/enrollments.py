"""The enrollments that the console runs: a bounded table of tasks, in the web process. A shell.

An enrollment is one code that a person brought; its secret stays here. Nothing is signed here: an
approval is the service's, which returns the identity that is then delivered. All of them end with
the process, and their nodes show a new code. Where all places are taken, what a session that may
only look has begun makes room for a phone's, and nothing that was approved makes room.
"""

import asyncio
import secrets
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from ca.enrollment import qr
from ca.enrollment.authority import AuthorityEnrollment
from ca.errors import CodeRefused, EnrollmentOver
from rossec.authority.console import owners
from rossec.authority.console.views import Outcome
from rossec.console.enrollment import Destination, Enrollment, EnrollmentService, Stage
from rossec.enrollment import address
from rossec.errors import EnrollmentUnknown, TooManyEnrollments
from rossec.net.aio.tasks import TaskSet
from rossec.shares import SharedTable

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
    """Every enrollment of one console.

    Args:
        service: the authority's service.
        domain: the trust domain.
        clock: seconds since the epoch.
        changed: called when a page of one of them shows something else.
    """

    def __init__(
        self,
        service: EnrollmentService,
        domain: str,
        clock: Callable[[], int],
        changed: Callable[[], None] = lambda: None,
    ) -> None:
        self._service = service
        self._domain = domain
        self._clock = clock
        self._changed = changed
        self._running: SharedTable[str, _Place] = SharedTable(MAX_RUNNING)
        self._ended: SharedTable[str, _Place] = SharedTable(MAX_KEPT)
        self._tasks = TaskSet()

    def __len__(self) -> int:
        """How many have not ended."""
        return sum(not place.found.is_over for _, place in self._running.items())

    def begin(self, text: str, given_address: str = "", owner: str = owners.LOOKER) -> str:
        """Begin with the text of a code; a label's also needs the node's address. Returns its id.

        `owner`: whose it is (`rossec.authority.console.owners`).

        Raises:
            CodeRefused: not a code, expired, or a label without an address.
            ConfigurationError: not an address.
            TooManyEnrollments: so many run already that do not make room.
        """
        code, now = qr.parse(text), self._clock()
        code.check_time(now)
        destination = _destination(code, given_address)
        self._settle()
        core = AuthorityEnrollment(code, self._domain, wildcard=True)
        found = Enrollment(core, destination, self._service, self._clock, self._changed)
        number = secrets.token_hex(16)
        place = _Place(number, found, owner)
        ended = None
        if self._count(owner) < MAX_RUNNING:  # nobody ends all of their own by beginning more
            ended = self._running.add(number, place, owner, owners.rank(owner))
        if ended is None:
            raise TooManyEnrollments(
                f"{MAX_RUNNING} nodes are being added already", "finish or reject one of them"
            )
        for each in ended:
            self._end(each)
        self._spawn(place, found.fetch)
        return number

    def get(self, number: str) -> Enrollment:
        """The enrollment with this id.

        Raises:
            EnrollmentUnknown: there is none, or no longer.
        """
        return self._place(number).found

    def approved(self, number: str, outcome: Outcome) -> None:
        """The request was approved: deliver the identity, as soon as it is signed.

        Raises:
            EnrollmentUnknown: there is none, or no longer.
        """
        place = self._place(number)
        if place.found.stage is Stage.COMPARED:
            place.found.approve(outcome)
            self._running.add(number, place, place.owner, _APPROVED)
            self._spawn(place, partial(place.found.deliver, outcome))

    async def reject(self, number: str) -> None:
        """A person has rejected the request: nothing is signed, and the record says so.

        Raises:
            EnrollmentUnknown: there is none, or no longer.
            EnrollmentOver: it is approved, or has ended.
        """
        await self.get(number).reject()

    async def differ(self, number: str) -> None:
        """A person says that the digits differ: nobody listens to the node any more.

        Raises:
            EnrollmentUnknown: there is none, or no longer.
            EnrollmentOver: there are no digits.
        """
        place = self._place(number)
        place.found.check_has_digits()
        if place.task is not None:
            place.task.cancel()
        await place.found.differ()

    async def close(self) -> None:
        """End all of them."""
        await self._tasks.close()

    def _count(self, owner: str) -> int:
        return sum(place.owner == owner for _, place in self._running.items())

    def _place(self, number: str) -> _Place:
        place = self._running.get(number) or self._ended.get(number)
        if place is None:
            raise EnrollmentUnknown("this console adds no such node, or no longer", _AGAIN)
        return place

    def _spawn(self, place: _Place, work: Callable[[], Coroutine[None, None, None]]) -> None:
        """Run a step; a page never waits for one that crashed."""

        async def run() -> None:
            try:
                await work()
            except Exception:
                place.found.fail(EnrollmentOver("the console has failed at this", _AGAIN))
                raise

        place.task = self._tasks.spawn(run(), name="an enrollment of the console")

    def _end(self, place: _Place) -> None:
        """End one that makes room for another's; its page says so."""
        place.found.fail(EnrollmentOver("its place was needed for another node", _AGAIN))
        if place.task is not None:
            place.task.cancel()
        self._keep(place)

    def _settle(self) -> None:
        """Free the places of those that have ended; nobody may look at the page of one left."""
        for number, place in self._running.items():
            place.found.check_time()
            if place.found.is_over:
                self._running.pop(number)
                self._keep(place)

    def _keep(self, place: _Place) -> None:
        self._ended.add(place.number, place, place.owner, owners.rank(place.owner))


def _destination(code: qr.Code, given_address: str) -> Destination:
    if not code.address and not given_address:
        raise CodeRefused(
            "this code is a label: it does not say where its node is",
            "type the address that the node shows, for example 192.168.1.7",
        )
    host, port = address.split(code.address or given_address)
    return Destination(host, port, "a screen" if code.secret else "a label")
