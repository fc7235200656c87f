"""What every ROS program asks for by itself."""

import pytest

from grants.model import Right
from grants.request import BASICS, is_basic, is_dispensable, is_timed, lasting_name, own_form


@pytest.mark.parametrize(
    ("node", "name", "own"),
    [
        ("/talker", "/talker/get_loggers", "{node}/get_loggers"),
        ("/a/b", "/a/b/c/d", "{node}/c/d"),
        ("/a/b", "/a/c", "/a/c"),
        ("/talker", "/talker", "/talker"),
        ("/talker", "/talkers/x", "/talkers/x"),
        ("/talker", "/talker_1/x", "/talker_1/x"),
        ("/rviz", "/rviz_1795466501944712825/x", "{node}/x"),
        ("/rostopic", "/rostopic_16936_1795466494397/x", "{node}/x"),
        ("/rviz", "/rviz_1795466501944712825", "/rviz_1795466501944712825"),
        ("/rviz", "/a/rviz_1795466501944712825/x", "/a/rviz_1795466501944712825/x"),
    ],
)
def test_names_below_the_own_name_are_own(node: str, name: str, own: str) -> None:
    assert own_form(node, name) == own


def test_a_node_with_a_tail_has_the_names_of_its_anonymous_nodes() -> None:
    assert own_form("/rviz", "/rviz_1/x", wildcard=True) == "{node}/x"
    assert own_form("/rviz", "/rviz_/x", wildcard=True) == "/rviz_/x"
    assert own_form("/rviz", "/rvizx/x", wildcard=True) == "/rvizx/x"


def test_names_that_will_not_come_again() -> None:
    assert is_timed("/rviz", "/rviz_1795466501944712825")
    assert is_timed("/rostopic", "/rostopic_16936_1795466494397")
    assert is_timed("/x", "/x_host_16936_1795466494397")
    assert not is_timed("/robot", "/robot_12")
    assert not is_timed("/robot", "/robot")
    assert not is_timed("/robot", "/other_1795466494397")


def test_the_lasting_name_has_no_numbers_of_one_run() -> None:
    assert lasting_name("/rviz_1795466501944712825") == "/rviz"
    assert lasting_name("/rostopic_16936_1795466494397/x") == "/rostopic/x"
    assert lasting_name("/robot_12/camera_3") == "/robot_12/camera_3"


def test_basics_are_no_more_than_a_client_library_asks_for() -> None:
    assert set(BASICS) == {Right.PUBLISH, Right.PROVIDE, Right.SUBSCRIBE, Right.PARAM_GET}
    assert is_basic(Right.PUBLISH, "/rosout")
    assert not is_basic(Right.SUBSCRIBE, "/rosout")
    assert not is_basic(Right.PARAM_SET, "/use_sim_time")
    assert not is_basic(Right.SUBSCRIBE, "/tf")
    assert is_basic(Right.SUBSCRIBE, "/clock")
    assert not any("*" in name for names in BASICS.values() for name in names)


def test_a_program_does_not_work_without_the_clock() -> None:
    assert not is_dispensable(Right.SUBSCRIBE, "/clock")
    assert is_dispensable(Right.PROVIDE, "{node}/get_loggers")
    assert not is_dispensable(Right.PROVIDE, "/other/get_loggers")
