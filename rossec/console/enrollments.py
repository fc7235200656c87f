"""The enrollments that the console runs: a bounded table of tasks, in the web process. A shell.

An enrollment is one code that a person brought; its secret stays here. Nothing is signed here: an
approval is the service's, which returns the identity that is then delivered. All of them end with
the process, and their nodes show a new code.
"""

import secrets
from collections.abc import Callable, Coroutine
from typing import Final

from ca.enrollment import qr
from ca.enrollment.authority import AuthorityEnrollment
from ca.errors import CodeRefused, EnrollmentOver
from rossec.authority.console.views import Outcome
from rossec.console.enrollment import Destination, Enrollment, EnrollmentService, Stage
from rossec.enrollment import address
from rossec.errors import EnrollmentUnknown, TooManyEnrollments
from rossec.net.aio.tasks import TaskSet

MAX_RUNNING: Final = 8
MAX_KEPT: Final = 32
_AGAIN: Final = "show a new code on the node, and scan it"


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
        self._all: dict[str, Enrollment] = {}
        self._tasks = TaskSet()

    def __len__(self) -> int:
        """How many have not ended."""
        return sum(not each.is_over for each in self._all.values())

    def begin(self, text: str, given_address: str = "") -> str:
        """Begin with the text of a code; a label's also needs the node's address. Returns its id.

        Raises:
            CodeRefused: not a code, expired, or a label without an address.
            ConfigurationError: not an address.
            TooManyEnrollments: so many run already.
        """
        code, now = qr.parse(text), self._clock()
        code.check_time(now)
        destination = _destination(code, given_address)
        for each in self._all.values():
            each.check_time()  # nobody may look at the page of one that was left
        if len(self) >= MAX_RUNNING:
            raise TooManyEnrollments(
                f"{MAX_RUNNING} nodes are being added already", "finish or reject one of them"
            )
        core = AuthorityEnrollment(code, self._domain, wildcard=True)
        found = Enrollment(core, destination, self._service, self._clock, self._changed)
        number = secrets.token_hex(16)
        self._all[number] = found
        self._forget()
        self._spawn(found, found.fetch())
        return number

    def get(self, number: str) -> Enrollment:
        """The enrollment with this id.

        Raises:
            EnrollmentUnknown: there is none, or no longer.
        """
        if number not in self._all:
            raise EnrollmentUnknown("this console adds no such node, or no longer", _AGAIN)
        return self._all[number]

    def approved(self, number: str, outcome: Outcome) -> None:
        """The request was approved: deliver the identity, as soon as it is signed.

        Raises:
            EnrollmentUnknown: there is none, or no longer.
        """
        found = self.get(number)
        if found.stage is Stage.COMPARED:
            found.approve(outcome)
            self._spawn(found, found.deliver(outcome))

    async def reject(self, number: str) -> None:
        """A person has rejected the request: nothing is signed, and the record says so.

        Raises:
            EnrollmentUnknown: there is none, or no longer.
            EnrollmentOver: it is approved, or has ended.
        """
        await self.get(number).reject()

    async def close(self) -> None:
        """End all of them."""
        await self._tasks.close()

    def _spawn(self, found: Enrollment, work: Coroutine[None, None, None]) -> None:
        """Run a step; a page never waits for one that crashed."""

        async def run() -> None:
            try:
                await work
            except Exception:
                found.fail(EnrollmentOver("the console has failed at this", _AGAIN))
                raise

        self._tasks.spawn(run(), name="an enrollment of the console")

    def _forget(self) -> None:
        """Keep the newest of those that have ended."""
        ended = [number for number, each in self._all.items() if each.is_over]
        for number in ended[: max(0, len(self._all) - MAX_KEPT)]:
            del self._all[number]


def _destination(code: qr.Code, given_address: str) -> Destination:
    if not code.address and not given_address:
        raise CodeRefused(
            "this code is a label: it does not say where its node is",
            "type the address that the node shows, for example 192.168.1.7",
        )
    host, port = address.split(code.address or given_address)
    return Destination(host, port, "a screen" if code.secret else "a label")
