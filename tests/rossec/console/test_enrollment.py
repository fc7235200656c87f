"""One node that is being added, against a robot that waits, and a service that signs."""

import asyncio
from dataclasses import dataclass, field

import pytest

from ca.certificates import to_pem
from ca.enrollment import qr
from ca.enrollment.sides import AuthorityEnrollment, AuthorityState, Pending
from ca.errors import EnrollmentExpired, EnrollmentOver
from rossec.authority.console.messages import ApprovalOutcome, IdentityRequestView, NodeView
from rossec.console.enrollments import DIFFERED, REJECTED, Destination, Enrollment, RecordedName, Stage
from rossec.errors import KeyServiceFailed
from tests.support.enrolling import NAME, Robot, WaitingRobot, clock
from tests.support.pki import Site

SITE = Site.create(now=clock())
APPROVAL = bytes(16)


@dataclass
class Service:
    """The authority's service, as far as an enrollment asks it; it signs after some questions."""

    known: tuple[NodeView, ...] = ()
    answers: list[ApprovalOutcome | KeyServiceFailed] = field(default_factory=list)
    waiting: tuple[IdentityRequestView, ...] = ()
    denied: list[tuple[bytes, str]] = field(default_factory=list)
    revoked: list[tuple[str, str]] = field(default_factory=list)
    refuses: KeyServiceFailed | None = None

    async def nodes(self) -> tuple[NodeView, ...]:
        return self.known

    async def identity_requests(self) -> tuple[IdentityRequestView, ...]:
        return self.waiting

    async def deny_request(self, request: bytes, reason: str) -> None:
        self.denied.append((request, reason))

    async def revoke_node(self, name: str, reason: str) -> tuple[int, int]:
        if self.refuses is not None:
            raise self.refuses
        self.revoked.append((name, reason))
        return 1, 2

    async def outcome(self, statement: bytes) -> ApprovalOutcome:
        assert statement == APPROVAL
        answer = self.answers.pop(0)
        if isinstance(answer, KeyServiceFailed):
            raise answer
        return answer


class Adding:
    """An enrollment of a robot, and the stages its page showed."""

    def __init__(self, robot: WaitingRobot, service: Service, code: str | None = None) -> None:
        self.service, self.stages = service, list[Stage]()
        self.now = 0
        core = AuthorityEnrollment(qr.parse(code or robot.code), "home", wildcard=True)
        destination = Destination("127.0.0.1", robot.port, "a screen")
        self.found = Enrollment(core, destination, service, self.clock, self.changed)

    def clock(self) -> int:
        return clock() + self.now

    def changed(self) -> None:
        self.stages.append(self.found.stage)

    def signed(self) -> ApprovalOutcome:
        return self.signed_for(self.found.core)

    @staticmethod
    def signed_for(core: AuthorityEnrollment) -> ApprovalOutcome:
        leaf = SITE.authority.issue(core.csr, now=clock(), serial=7, wildcard=core.request.wildcard)
        return ApprovalOutcome(APPROVAL, "done", "", to_pem(leaf, SITE.root))


def waiting() -> ApprovalOutcome:
    return ApprovalOutcome(APPROVAL, "waiting", "", b"")


def node(key: bytes, **changes: int) -> NodeView:
    times = {"not_before": 0, "not_after": clock() + 60, "revoked_at": 0} | changes
    return NodeView(NAME, key, times["not_before"], times["not_after"], False, times["revoked_at"], "")


@pytest.mark.parametrize("label", [False, True])
async def test_a_node_is_enrolled_when_it_says_so_itself(label: bool) -> None:
    with WaitingRobot(Robot(), label=label) as robot:
        adding = Adding(robot, Service())
        await adding.found.fetch()
        assert adding.found.core.request.name == NAME
        outcome = adding.signed()
        adding.found.approve(outcome)
        await adding.found.deliver(outcome)
    assert adding.stages == [Stage.COMPARED, Stage.DELIVERING, Stage.DELIVERING, Stage.DIGITS, Stage.ENROLLED]
    assert [pending.digits for pending in robot.trusted] == [adding.found.core.digits]
    assert adding.found.is_over
    assert adding.found.error is None


async def test_a_node_with_a_tail_of_anonymous_nodes_can_be_added() -> None:
    with WaitingRobot(Robot(wildcard=True)) as robot:
        adding = Adding(robot, Service())
        await adding.found.fetch()
        assert adding.found.core.request.wildcard
        await adding.found.deliver(adding.signed())
    assert adding.found.stage is Stage.ENROLLED


async def test_the_identity_is_delivered_when_the_key_is_unlocked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rossec.console.enrollments.POLL", 0.0)
    with WaitingRobot(Robot()) as robot:
        adding = Adding(robot, Service())
        await adding.found.fetch()
        away = KeyServiceFailed("the service is started again")
        adding.service.answers = [waiting(), away, waiting(), adding.signed()]
        adding.found.approve(waiting())
        await adding.found.deliver(waiting())
    assert adding.stages[1:] == [Stage.WAITING, Stage.DELIVERING, Stage.DIGITS, Stage.ENROLLED]


async def test_a_key_that_stays_locked_for_longer_than_the_node_waits() -> None:
    with WaitingRobot(Robot()) as robot:
        adding = Adding(robot, Service())
        await adding.found.fetch()
        adding.found.approve(waiting())
        adding.now = 301
        await adding.found.deliver(waiting())
    assert adding.found.stage is Stage.FAILED
    assert isinstance(adding.found.error, EnrollmentExpired)


@pytest.mark.parametrize("state", ["failed", "expired", "done"])
async def test_what_was_not_signed_is_told_with_its_reason(state: str) -> None:
    with WaitingRobot(Robot()) as robot:
        adding = Adding(robot, Service())
        await adding.found.fetch()
        await adding.found.deliver(ApprovalOutcome(APPROVAL, state, "another key", b""))
    assert adding.found.stage is Stage.FAILED
    assert str(adding.found.error) == "the authority did not sign it: another key"
    assert adding.found.error is not None
    assert adding.found.error.__traceback__ is None


async def test_a_node_that_swaps_its_request_is_told_apart() -> None:
    with WaitingRobot(Robot()) as robot, WaitingRobot(Robot()) as other:
        adding = Adding(robot, Service(), code=other.code)
        await adding.found.fetch()
    assert adding.found.stage is Stage.SWAPPED
    assert "not the one the code was made for" in str(adding.found.error)


async def test_a_person_at_the_node_says_no() -> None:
    def wrong(_: Pending) -> str:
        return "wrong"

    with WaitingRobot(Robot(), person=wrong) as robot:
        adding = Adding(robot, Service())
        await adding.found.fetch()
        await adding.found.deliver(adding.signed())
    assert adding.found.stage is Stage.FAILED
    assert "the node has ended the enrollment" in str(adding.found.error)


@pytest.mark.parametrize("known", list(RecordedName))
async def test_digits_that_differ_end_it_and_what_was_signed(known: RecordedName) -> None:
    """The key may be another's; one that was known before got no more than it had."""
    with WaitingRobot(Robot()) as robot:
        adding = Adding(robot, Service())
        await adding.found.fetch()
        with pytest.raises(EnrollmentOver, match="no digits"):
            await adding.found.differ()
    adding.found.known, adding.found.stage = known, Stage.DIGITS
    await adding.found.differ()
    assert adding.found.stage is Stage.DIFFERED
    assert adding.found.is_over
    assert adding.found.core.state is AuthorityState.OVER
    expected = [] if known is RecordedName.SAME_KEY else [(NAME, DIFFERED)]
    assert adding.service.revoked == expected


async def test_what_could_not_be_revoked_is_kept_as_the_reason() -> None:
    with WaitingRobot(Robot()) as robot:
        adding = Adding(robot, Service(refuses=KeyServiceFailed("the service does not run")))
        await adding.found.fetch()
    adding.found.stage = Stage.ENROLLED  # somebody pressed too late
    await adding.found.differ()
    assert adding.found.stage is Stage.DIFFERED
    assert str(adding.found.error) == "the service does not run"


async def test_a_node_that_never_answers_is_not_waited_for_forever(monkeypatch: pytest.MonkeyPatch) -> None:
    async def never(*_: object) -> None:
        raise TimeoutError

    monkeypatch.setattr("rossec.console.enrollments.deliver", never)
    with WaitingRobot(Robot()) as robot:
        adding = Adding(robot, Service())
        await adding.found.fetch()
        await adding.found.deliver(adding.signed())
    assert "did not answer in time" in str(adding.found.error)


async def test_a_rejected_request_is_denied_in_the_record_too() -> None:
    with WaitingRobot(Robot()) as robot:
        adding = Adding(robot, Service())
        await adding.found.fetch()
        csr = adding.found.core.csr
        adding.service.waiting = tuple(
            IdentityRequestView(number, NAME, b"k", "", 0, 0, "pending", False, False, request)
            for number, request in ((b"1", csr), (b"2", b"another"))
        )
        await adding.found.reject()
        with pytest.raises(EnrollmentOver):
            await adding.found.reject()
    assert adding.found.stage is Stage.REJECTED
    assert adding.service.denied == [(b"1", REJECTED)]


@pytest.mark.parametrize(
    ("key", "changes", "known"),
    [
        (b"another", {}, RecordedName.OTHER_KEY),
        (b"another", {"revoked_at": 5}, RecordedName.NEW),
        (b"another", {"not_after": 5}, RecordedName.NEW),
        (b"", {}, RecordedName.SAME_KEY),
    ],
)
async def test_what_the_record_says_of_the_name(
    key: bytes, changes: dict[str, int], known: RecordedName
) -> None:
    robot = Robot()
    with WaitingRobot(robot) as there:
        adding = Adding(there, Service())
        await adding.found.fetch()
        own = adding.found.core.request.thumbprint
        adding = Adding(there, Service((node(key or own, **changes),)))
        await adding.found.fetch()
    assert adding.found.known is known
    assert adding.found.is_other_key is (known is RecordedName.OTHER_KEY)
    assert adding.found.source.startswith("a screen at 127.0.0.1:")


async def test_a_person_who_decides_too_late_decides_nothing() -> None:
    with WaitingRobot(Robot()) as robot:
        adding = Adding(robot, Service())
        with pytest.raises(EnrollmentOver):
            adding.found.check_can_approve()
        await adding.found.fetch()
        adding.found.check_can_approve()
        adding.now = 301
        with pytest.raises(EnrollmentExpired):
            adding.found.check_can_approve()
        adding.found.check_time()
    assert adding.found.stage is Stage.FAILED
    assert adding.found.deadline <= adding.clock()


async def test_nobody_at_the_address() -> None:
    with WaitingRobot(Robot()) as robot:
        adding = Adding(robot, Service())
    await asyncio.sleep(0)
    await adding.found.fetch()
    assert adding.found.stage is Stage.FAILED
    assert "no node waits to be enrolled" in str(adding.found.error)
