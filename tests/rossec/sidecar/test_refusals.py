"""Refusals in the log of a sidecar."""

import logging

import pytest

from grants.missing_rights import MissingRight, missing_right
from grants.model import Right
from rossec.sidecar.refusals import SAID_FOR, MissingRights, RefusalLog
from tests.support.witness import until

NO_GOAL = (
    "rossec: /rviz_17 (certified as /rviz) needs the right publish on /goal:"
    " no grant for publish on /goal (ask the authority for a grant)"
)


class Hours:
    """A clock that a test moves."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def missing(right: Right, name: str, asker: str = "/rviz_17") -> MissingRight:
    return MissingRight("/rviz", asker, right, name)


async def test_other_refusals_are_logged_at_once_on_one_line(
    caplog: pytest.LogCaptureFixture,
) -> None:
    RefusalLog().log("the master", "getParam", [-1, "rossec: too many\nof them", 0])
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    assert "the master refuses getParam: too many" in caplog.text
    assert len(caplog.messages[0].splitlines()) == 1


@pytest.mark.parametrize(
    "answer",
    [[1, "rossec: fine", 0], [-1, "not known", 0], [0, 7, 0], [], None, b"<xml/>"],
    ids=["success", "of-the-program", "no-text", "empty", "none", "not-parsed"],
)
async def test_refusals_of_others_are_not_logged(
    caplog: pytest.LogCaptureFixture, answer: object
) -> None:
    log = RefusalLog()
    log.log("the master", "getParam", answer)
    log.flush()
    assert caplog.messages == []


async def test_missing_rights_are_logged_together_and_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    log = RefusalLog()
    for status in (NO_GOAL, NO_GOAL.replace("/goal", "/pose"), NO_GOAL):
        log.log("the master", "registerPublisher", [-1, status, 0])
    assert caplog.messages == []
    await until(lambda: bool(caplog.messages), within=20)
    log.log("the master", "registerPublisher", [-1, NO_GOAL, 0])
    log.flush()
    [line] = caplog.messages
    assert line.endswith("an allow rule for /rviz with publish: [/goal, /pose] would change it")


async def test_what_was_collected_is_logged_at_the_end(caplog: pytest.LogCaptureFixture) -> None:
    log = RefusalLog()
    log.log("the master", "registerPublisher", [-1, NO_GOAL, 0])
    log.flush()
    assert len(caplog.messages) == 1


def test_what_every_program_asks_for_is_no_warning() -> None:
    """But of the clock it is: without it a program in a simulation stands still."""
    found = MissingRights(Hours())
    assert not found.add(missing(Right.PUBLISH, "/rosout"))
    assert not found.add(missing(Right.PROVIDE, "/rviz_17/get_loggers"))
    assert not found.add(missing(Right.PARAM_GET, "/use_sim_time"))
    assert found.add(missing(Right.SUBSCRIBE, "/clock"))
    assert found.add(missing(Right.PROVIDE, "/other/get_loggers"))
    assert found.add(missing(Right.SUBSCRIBE, "/rosout"))


def test_a_refusal_is_told_again_after_an_hour() -> None:
    clock = Hours()
    found = MissingRights(clock)
    assert found.add(missing(Right.PUBLISH, "/goal"))
    assert len(found.take()) == 1
    clock.now = SAID_FOR - 1
    assert not found.add(missing(Right.PUBLISH, "/goal"))
    assert found.add(missing(Right.PUBLISH, "/goal", "/rviz_18"))  # another program
    clock.now = SAID_FOR
    assert found.add(missing(Right.PUBLISH, "/goal"))
    assert len(found.take()) == 1
    assert found.take() == []


def test_what_is_remembered_is_bounded() -> None:
    found = MissingRights(Hours())
    assert all(found.add(missing(Right.CALL, f"/s{number}")) for number in range(1100))
    assert found.add(missing(Right.CALL, "/s0"))
    assert not found.add(missing(Right.CALL, "/s1099"))


def test_the_status_of_the_master_is_understood() -> None:
    assert missing_right(NO_GOAL) == missing(Right.PUBLISH, "/goal")
