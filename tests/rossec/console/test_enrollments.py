"""The table of nodes that are being added."""

import asyncio
from collections.abc import AsyncIterator

import pytest

from ca.enrollment import qr
from ca.errors import CodeRefused, EnrollmentOver
from rossec.authority.console import messages
from rossec.authority.console.messages import ApprovalOutcome
from rossec.console.enrollments import (
    MAX_KEPT,
    MAX_RUNNING,
    WAITING,
    Enrollment,
    Enrollments,
    RecordedName,
    Stage,
)
from rossec.errors import ConfigurationError, RossecError
from tests.rossec.console.test_enrollment import Service
from tests.support import refusal_texts
from tests.support.enrolling import NAME, Robot, WaitingRobot, clock


def waiting() -> ApprovalOutcome:
    return ApprovalOutcome(bytes(16), WAITING, "", b"")


SIGNED = ApprovalOutcome(bytes(16), "failed", "the key is broken", b"")


class Changes:
    """Counts, and lets a test wait for a stage."""

    def __init__(self) -> None:
        self.event = asyncio.Event()

    def __call__(self) -> None:
        self.event.set()

    async def until(self, found: Enrollment, *stages: Stage) -> None:
        async with asyncio.timeout(20):
            while found.stage not in stages:
                self.event.clear()
                await self.event.wait()


@pytest.fixture
async def table() -> AsyncIterator[tuple[Enrollments, Changes]]:
    changes = Changes()
    made = Enrollments(Service(), "home", clock, changes)
    yield made, changes
    await made.close()


Table = tuple[Enrollments, Changes]


async def test_a_code_begins_an_enrollment_whose_pages_follow_it(table: Table) -> None:
    enrollments, changes = table
    with WaitingRobot(Robot()) as robot:
        number = enrollments.begin(robot.code)
        found = enrollments.get(number)
        await changes.until(found, Stage.COMPARED)
        assert found.core.request.name == NAME
        assert len(enrollments) == 1
        enrollments.approved(number, SIGNED)
        enrollments.approved(number, SIGNED)  # a second browser: nothing happens twice
        await changes.until(found, Stage.FAILED)
    assert "the key is broken" in str(found.error)
    assert len(enrollments) == 0


async def test_a_label_needs_the_address_of_its_node(table: Table) -> None:
    enrollments, changes = table
    with WaitingRobot(Robot(), label=True) as robot:
        with pytest.raises(CodeRefused, match="a label: it does not say where its node is"):
            enrollments.begin(robot.code)
        with pytest.raises(ConfigurationError, match="is not an address"):
            enrollments.begin(robot.code, "no where")
        found = enrollments.get(enrollments.begin(robot.code, robot.where))
        await changes.until(found, Stage.COMPARED)
        assert found.source == f"a label at {robot.where}"


async def test_a_code_that_has_expired_begins_nothing(table: Table) -> None:
    enrollments, _ = table
    node = Robot().enrollment(now=clock() - 1000)
    with pytest.raises(CodeRefused, match=refusal_texts.CODE_EXPIRED):
        enrollments.begin(node.code("127.0.0.1:9"))
    with pytest.raises(CodeRefused):
        enrollments.begin("https://example.org")
    assert len(enrollments) == 0


async def test_the_number_of_enrollments_is_bounded(table: Table) -> None:
    enrollments, _ = table
    with WaitingRobot(Robot()) as robot:
        for _ in range(MAX_RUNNING):
            enrollments.begin(robot.code)
        with pytest.raises(RossecError, match="being added already"):
            enrollments.begin(robot.code)


async def test_those_that_were_left_do_not_keep_others_out() -> None:
    """Nobody looks at their pages any more, so nothing but the next one notices."""
    now, changes = clock(), Changes()
    enrollments = Enrollments(Service(), "home", lambda: now, changes)
    with WaitingRobot(Robot()) as robot:
        left = [enrollments.get(enrollments.begin(robot.code)) for _ in range(MAX_RUNNING)]
        for found in left:
            await changes.until(found, Stage.COMPARED, Stage.FAILED)
        now = max(found.deadline for found in left) + 1
        number = enrollments.begin(qr.label_code(b"a request"), "127.0.0.1:9")
        assert all(found.is_over for found in left)
        await changes.until(enrollments.get(number), Stage.FAILED)
    await enrollments.close()


async def test_the_oldest_that_ended_are_forgotten(table: Table) -> None:
    enrollments, changes = table
    text = qr.label_code(b"a request")
    numbers = []
    for _ in range(MAX_KEPT + 3):
        numbers.append(enrollments.begin(text, "127.0.0.1:9"))
        await changes.until(enrollments.get(numbers[-1]), Stage.FAILED)
    with pytest.raises(RossecError, match="adds no such node"):
        enrollments.get(numbers[0])
    enrollments.get(numbers[-1])


async def test_a_rejected_node_is_not_approved_afterwards(table: Table) -> None:
    enrollments, changes = table
    with WaitingRobot(Robot()) as robot:
        number = enrollments.begin(robot.code)
        found = enrollments.get(number)
        await changes.until(found, Stage.COMPARED)
        await enrollments.get(number).reject()
        enrollments.approved(number, SIGNED)
        assert found.stage is Stage.REJECTED
        with pytest.raises(EnrollmentOver):
            await enrollments.get(number).reject()
    with pytest.raises(RossecError, match="adds no such node"):
        await enrollments.get("0" * 32).reject()


async def test_digits_that_differ_end_the_listening(table: Table, monkeypatch: pytest.MonkeyPatch) -> None:
    enrollments, changes = table

    async def listens(*_: object) -> None:
        await asyncio.Event().wait()

    monkeypatch.setattr("rossec.console.enrollments.fetch", listens)
    number = enrollments.begin(qr.label_code(b"x"), "127.0.0.1")
    found = enrollments.get(number)
    with pytest.raises(EnrollmentOver, match="no digits"):
        await enrollments.differ(number)
    assert len(enrollments._tasks) == 1, "nothing was ended"
    found.known, found.stage = RecordedName.SAME_KEY, Stage.DIGITS
    await enrollments.differ(number)
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert (found.stage, len(enrollments._tasks)) == (Stage.DIFFERED, 0)
    assert changes is not None
    with pytest.raises(RossecError, match="adds no such node"):
        await enrollments.differ("0" * 32)


async def test_a_step_that_crashes_ends_its_enrollment(
    table: Table, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    enrollments, changes = table

    async def broken(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("rossec.console.enrollments.fetch", broken)
    found = enrollments.get(enrollments.begin(qr.label_code(b"x"), "127.0.0.1"))
    await changes.until(found, Stage.FAILED)
    await asyncio.sleep(0)
    assert str(found.error) == "the console has failed at this"
    assert "crashed" in caplog.text


@pytest.mark.attack("looker-floods")
async def test_lookers_make_room_for_a_phone_and_approved_ones_for_nobody(
    table: Table, monkeypatch: pytest.MonkeyPatch
) -> None:
    enrollments, changes = table
    monkeypatch.setattr("rossec.console.enrollments.POLL", 600.0)
    lookers = [messages.of_looker(bytes([number])) for number in range(2)]
    phone, label = messages.of_phone("mine"), qr.label_code(b"a request")
    with WaitingRobot(Robot()) as robot:
        approved = enrollments.begin(robot.code, "", lookers[0])
        await changes.until(enrollments.get(approved), Stage.COMPARED)
        enrollments.approved(approved, waiting())

        async def fetches(*_: object) -> None:
            await asyncio.Event().wait()

        monkeypatch.setattr("rossec.console.enrollments.fetch", fetches)
        theirs = [enrollments.begin(robot.code, "", lookers[0]) for _ in range(MAX_RUNNING - 1)]
        with pytest.raises(RossecError, match="being added already"):
            enrollments.begin(label, "127.0.0.1:9", lookers[0])
        enrollments.begin(robot.code, "", lookers[1])
        assert str(enrollments.get(theirs[0]).error) == "its place was needed for another node"
        mine = [enrollments.begin(robot.code, "", phone) for _ in range(MAX_RUNNING - 1)]
        with pytest.raises(RossecError, match="being added already"):
            enrollments.begin(label, "127.0.0.1:9", lookers[1])
        assert len(enrollments) == MAX_RUNNING
        assert not any(enrollments.get(each).is_over for each in mine)
        assert enrollments.get(approved).stage is Stage.WAITING
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert len(enrollments._tasks) == MAX_RUNNING, "those of the others were ended as well"
