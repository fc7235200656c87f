"""One node that is being added: from the code that a person brought to the node's own last word.

The states are those that a page shows. The protocol is `ca.enrollment.authority`, over sockets in
`rossec.enrollment.authority`; this puts them together with the service, which alone signs. It says
ENROLLED only when the node has said so, and every failure is kept with its reason.
"""

import asyncio
import secrets
from collections.abc import Callable
from enum import Enum
from typing import Final, NamedTuple, Protocol

from ca.certificates import from_pem
from ca.enrollment import NONCE_SIZE, WINDOW
from ca.enrollment.authority import AuthorityEnrollment, AuthorityState
from ca.errors import EnrollmentExpired, EnrollmentOver, HintedError, RequestSwapped
from rossec.authority.console.views import IdentityRequestView, NodeView, Outcome
from rossec.enrollment import address
from rossec.enrollment.authority import deliver, fetch
from rossec.errors import KeyServiceFailed

REJECTED: Final = "rejected at the console"
DIFFERED: Final = "the digits differed"
DONE, WAITING = "done", "waiting"  # states of an outcome
POLL: Final = 1.0  # seconds
_PATIENCE: Final = 3600  # seconds that a label waits for the key; a screen code ends sooner


class Stage(Enum):
    """What the page of an enrollment shows."""

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


OVER: Final = frozenset(
    {Stage.ENROLLED, Stage.REJECTED, Stage.DIFFERED, Stage.SWAPPED, Stage.FAILED}
)


class Known(Enum):
    """What the record says of the name that is asked for."""

    NEW = "new"
    SAME_KEY = "same key"
    OTHER_KEY = "other key"


class Destination(NamedTuple):
    """Where the node waits, and what showed its code."""

    host: str
    port: int
    kind: str


class EnrollmentService(Protocol):
    """The operations of the service that an enrollment needs."""

    async def nodes(self) -> tuple[NodeView, ...]:
        """The identities."""
        ...

    async def identity_requests(self) -> tuple[IdentityRequestView, ...]:
        """The requests that wait."""
        ...

    async def deny_request(self, request: bytes, reason: str) -> None:
        """Deny one."""
        ...

    async def revoke_node(self, name: str, reason: str) -> tuple[int, int]:
        """Revoke every key of a name."""
        ...

    async def outcome(self, statement: bytes, /) -> Outcome:
        """What came of an approval."""
        ...


class Enrollment:
    """One of them.

    Attributes:
        core: the protocol.
        stage: what the page shows.
        known: what the record says of the name; of meaning from COMPARED on.
        error: why it failed, or None.
    """

    def __init__(
        self,
        core: AuthorityEnrollment,
        destination: Destination,
        service: EnrollmentService,
        clock: Callable[[], int],
        changed: Callable[[], None],
    ) -> None:
        self.core = core
        self.stage = Stage.FETCHING
        self.known = Known.NEW
        self.error: HintedError | None = None
        self._destination = destination
        self._service = service
        self._clock = clock
        self._changed = changed
        self._begun = clock()

    @property
    def is_over(self) -> bool:
        """Whether nothing more happens."""
        return self.stage in OVER

    @property
    def source(self) -> str:
        """Where the code came from, for people and the record."""
        host, port, kind = self._destination
        return f"{kind} at {address.join(host, port)}"

    @property
    def is_other_key(self) -> bool:
        """Whether the name has another key by now, which would be revoked."""
        return self.known is Known.OTHER_KEY

    @property
    def deadline(self) -> int:
        """Until when the next step is possible."""
        return self.core.deadline or self._begun + _PATIENCE

    def check_can_approve(self) -> None:
        """Return if a person may approve it now.

        Raises:
            EnrollmentOver: there is nothing to approve, or no longer.
            EnrollmentExpired: too late.
        """
        if self.stage is Stage.COMPARED:
            self._end_if_late()
        if self.stage is not Stage.COMPARED:
            raise EnrollmentOver(
                f"this node is not to be decided on: {self.stage.value}", "load the page anew"
            )

    def check_time(self) -> None:
        """End it if a person decides too late, so that its page says so."""
        if self.stage is Stage.COMPARED:
            try:
                self._end_if_late()
            except EnrollmentExpired as error:
                self.fail(error)

    async def fetch(self) -> None:
        """Get the request from the node, and what the record says of its name."""
        try:
            host, port, _ = self._destination
            await fetch(self.core, host, port, self._clock)
            self.known = _known(await self._service.nodes(), self.core, self._clock())
            self._move(Stage.COMPARED)
        except HintedError as error:
            self.fail(error)

    def approve(self, outcome: Outcome) -> None:
        """The service has verified an approval."""
        self._move(Stage.WAITING if outcome.state == WAITING else Stage.DELIVERING)

    async def deliver(self, outcome: Outcome) -> None:
        """Deliver the identity when it is signed, and listen until the node says how it ended."""
        try:
            self.core.approve(self._clock())
            bundle = await self._signed(outcome)
            *chain, root = from_pem(bundle)
            offer = self.core.offer(chain, root, secrets.token_bytes(NONCE_SIZE), self._clock())
            self._move(Stage.DELIVERING)
            host, port, _ = self._destination
            async with asyncio.timeout(2 * WINDOW):
                await deliver(self.core, offer, host, port, self._clock, self._show)
            self._move(Stage.ENROLLED)
        except HintedError as error:
            self.fail(error)
        except TimeoutError:
            self.fail(EnrollmentExpired("the node did not answer in time", "look at the node"))

    async def reject(self) -> None:
        """A person has rejected it: the record says so too, if the request got there.

        Raises:
            EnrollmentOver: it was approved, or has ended.
        """
        if self.stage is not Stage.COMPARED:
            raise EnrollmentOver("this node is not to be decided on", "load the page anew")
        self.core.deny()
        self._move(Stage.REJECTED)
        for each in await self._service.identity_requests():
            if each.csr == self.core.csr:
                await self._service.deny_request(each.id, REJECTED)

    def check_has_digits(self) -> None:
        """Return if there are, or were, digits to compare.

        Raises:
            EnrollmentOver: there are none.
        """
        if self.stage not in {Stage.DIGITS, Stage.ENROLLED}:
            raise EnrollmentOver("there are no digits to compare here", "load the page anew")

    async def differ(self) -> None:
        """A person says that the digits differ: it ends, and what was signed is revoked.

        The code may have been another's, and its key has an identity now. A key that was known
        under this name before got no more than it had, and keeps that. If the revocation is
        refused, `error` says so.
        """
        self.check_has_digits()
        self.core.state = AuthorityState.OVER
        self._move(Stage.DIFFERED)
        if self.known is Known.SAME_KEY:
            return
        try:
            await self._service.revoke_node(self.core.request.name, DIFFERED)
        except HintedError as error:
            self.error = error.bare()
            self._changed()

    def fail(self, error: HintedError) -> None:
        """End it with this reason."""
        self.core.state = AuthorityState.OVER
        self.error = error.bare()
        self._move(Stage.SWAPPED if isinstance(error, RequestSwapped) else Stage.FAILED)

    async def _signed(self, outcome: Outcome) -> bytes:
        """The identity (PEM), as soon as the key is unlocked.

        Raises:
            EnrollmentOver: it was not signed, and never will be.
            EnrollmentExpired: the node waits no longer.
        """
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

    def _show(self, _: str) -> None:
        self._move(Stage.DIGITS)

    def _move(self, stage: Stage) -> None:
        self.stage = stage
        self._changed()


def _known(nodes: tuple[NodeView, ...], core: AuthorityEnrollment, now: int) -> Known:
    """Whether the name is taken: by this key, or by another one that counts."""
    request = core.request
    named = [each for each in nodes if each.name == request.name and not each.revoked_at]
    if any(each.key != request.thumbprint and each.not_after > now for each in named):
        return Known.OTHER_KEY
    return Known.SAME_KEY if any(each.key == request.thumbprint for each in named) else Known.NEW
