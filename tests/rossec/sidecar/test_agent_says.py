"""What a sidecar says of calls whose refusal a program does not show."""

import logging
from pathlib import Path

import pytest

from grants.model import Right
from tests.rossec.sidecar.program import Program, sidecar
from tests.support.site import Site

UNSEEN = "nothing that /robot may see; all of it needs: rossec grant sign /robot --graph"


async def test_what_programs_keep_to_themselves_is_said_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """rosparam of rospy, rosbag under an anonymous name, rostopic list without a right."""
    async with Site(tmp_path / "site").running() as site:
        site.enroll("/robot")
        site.subscribe("/robot", "/word")
        async with (
            sidecar(site, each=False, identity="/robot") as served,
            Program("/robot", served) as program,
            Program("/robot_17_1732", served) as anonymous,
        ):
            for _ in range(2):
                answer = await program.ask(program.master_uri, "setParam", "/t\u00fcr", 1)
                assert answer == [-1, "ERROR: parameter [key] contains illegal chars", 0]
                assert await program.ask(program.master_uri, "getSystemState") == [
                    1,
                    "current system state",
                    [[], [], []],
                ]
                answer = await anonymous.ask(
                    anonymous.master_uri, "registerSubscriber", "/word", "std_msgs/String", anonymous.uri
                )
                assert isinstance(answer, list)
                assert answer[0] == -1
    said = [each.getMessage() for each in caplog.records if each.levelno >= logging.WARNING]
    for beginning, end in (
        ("the master refuses setParam: '/t\\xfcr' is not an absolute ROS name", "_)"),
        ("getSystemState: nothing", UNSEEN),
        ("the sidecar of /robot refuses registerSubscriber: ", "node request /robot --anonymous"),
    ):
        assert sum(each.startswith(beginning) and each.endswith(end) for each in said) == 1, said


async def test_who_may_see_the_graph_is_told_nothing_of_an_empty_one(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async with Site(tmp_path / "site").running() as site:
        site.enroll("/robot")
        site.grant("/robot", Right.GRAPH, "/**")
        async with (
            sidecar(site, each=False, identity="/robot") as served,
            Program("/robot", served) as program,
        ):
            await program.ask(program.master_uri, "getSystemState")
    assert "nothing that /robot may see" not in caplog.text
