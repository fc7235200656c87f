"""Refusals in the log of a sidecar."""

import logging
import socket

import pytest

from grants.model import Right
from grants.request import MissingRight, missing_right
from rossec.errors import PeerUnreachable
from rossec.sidecar.egress import SAID_FOR, MissingRights, RefusalLog, Said
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


async def test_other_refusals_are_logged_at_once_on_one_line(caplog: pytest.LogCaptureFixture) -> None:
    RefusalLog().log("the master", "getParam", [-1, "rossec: too many\nof them", 0])
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    assert "the master refuses getParam: too many" in caplog.text
    assert len(caplog.messages[0].splitlines()) == 1


@pytest.mark.parametrize(
    "answer",
    [[1, "rossec: fine", 0], [-1, "not known", 0], [0, 7, 0], [], None, b"<xml/>"],
    ids=["success", "of-the-program", "no-text", "empty", "none", "not-parsed"],
)
async def test_refusals_of_others_are_not_logged(caplog: pytest.LogCaptureFixture, answer: object) -> None:
    log = RefusalLog()
    log.log("the master", "getParam", answer)
    log.flush()
    assert caplog.messages == []


async def test_missing_rights_are_logged_together_and_once(caplog: pytest.LogCaptureFixture) -> None:
    log = RefusalLog()
    for status in (NO_GOAL, NO_GOAL.replace("/goal", "/pose"), NO_GOAL):
        log.log("the master", "registerPublisher", [-1, status, 0])
    assert caplog.messages == []
    await until(lambda: bool(caplog.messages), within=20)
    log.log("the master", "registerPublisher", [-1, NO_GOAL, 0])
    log.flush()
    [line] = caplog.messages
    assert line.endswith(
        "an allow rule for /rviz with publish: [/goal, /pose] would change it,"
        " or rossec grant sign /rviz --publish /goal --publish /pose"
    )


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


def cannot_connect(cause: OSError) -> PeerUnreachable:
    error = PeerUnreachable(f"cannot connect to r2 port 4000: {cause.strerror}")
    error.__cause__ = cause
    return error


async def test_a_peer_whose_name_is_not_known_is_said_once(caplog: pytest.LogCaptureFixture) -> None:
    """The program sees a closed connection, and tries again in silence."""
    log = RefusalLog()
    error = cannot_connect(socket.gaierror(-2, "Name or service not known"))
    for _ in range(3):
        log.unreachable("http://r2:4000/", error)
    log.unreachable("http://r3:4000/", cannot_connect(ConnectionRefusedError(111, "refused")))
    (said,) = caplog.messages
    assert said.startswith("http://r2:4000/ is out of reach: cannot connect to r2 port 4000: Name")
    assert "(is ROS_IP or ROS_HOSTNAME right on its side, and its name known" in said


def test_what_was_said_an_hour_ago_is_new() -> None:
    hours = Hours()
    said = Said[str](hours)
    assert [said.add("x"), said.add("x")] == [True, False]
    hours.now = SAID_FOR
    assert said.add("x")


async def test_what_a_program_does_not_hear_of_is_said(caplog: pytest.LogCaptureFixture) -> None:
    answer = [-1, "ERROR: parameter [key] contains illegal chars", 0]
    log = RefusalLog()
    for _ in range(2):
        log.log("the master", "setParam", answer, ("/robot", "/t\u00fcr", 1))
    [line] = caplog.messages
    assert "the master refuses setParam: " in line
    assert "for example /tur: " in line


async def test_what_the_sidecar_itself_refuses_is_said_once(caplog: pytest.LogCaptureFixture) -> None:
    log = RefusalLog()
    own = [-1, "rossec: a program with the identity of /record calls itself /record_17", 0]
    for _ in range(2):
        log.log_own("/record", "registerSubscriber", own)
    [line] = caplog.messages
    assert line.startswith("the sidecar of /record refuses registerSubscriber: a program with")
    log.log("the master", "getPid", [-1, "rossec: too many", 0])
    log.log_own("/record", "getPid", [-1, "rossec: too many", 0])
    assert len(caplog.messages) == 2, "the master's was said already"
    log.log_own("/rviz", "registerPublisher", [-1, NO_GOAL, 0])
    assert len(caplog.messages) == 2, "what is missing is said otherwise"


async def test_a_graph_of_which_nothing_is_shown_is_said_once(caplog: pytest.LogCaptureFixture) -> None:
    log = RefusalLog()
    log.log_own("/robot", "getSystemState", [1, "", [[["/a", ["/n"]]], [], []]])
    assert caplog.messages == []
    for _ in range(2):
        log.log_own("/robot", "getSystemState", [1, "", [[], [], []]])
        log.log_own("/robot", "getTopicTypes", [1, "", []])
    [line] = caplog.messages
    assert line.endswith("nothing that /robot may see; all of it needs: rossec grant sign /robot --graph")
