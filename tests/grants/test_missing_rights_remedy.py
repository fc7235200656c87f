"""The commands that give a missing right, as they are typed."""

import shlex

import pytest

from grants.model import Right
from grants.request import grant_command, in_shell, remedy


def test_a_missing_right_has_its_command() -> None:
    assert remedy("/robot", Right.PUBLISH, "/robot/pose") == (
        "rossec grant sign /robot --publish /robot/pose, or ask: `rossec grant request`"
    )


def test_what_nobody_may_ask_for_is_only_given() -> None:
    assert remedy("/op", Right.ADMIN, "/robot") == "rossec grant sign /op --admin /robot"


def test_several_rights_are_one_command() -> None:
    given = [(Right.GRAPH, "/**"), (Right.PARAM_GET, "{node}/x"), (Right.GRAPH, "/a")]
    assert grant_command("/rviz", given) == "rossec grant sign /rviz --graph --param-get '{node}/x'"


@pytest.mark.parametrize("name", ["/a_B/c1", "hospital:/x", "{node}/x", "/a/**", "/a b", "/$x"])
def test_a_name_is_one_word_of_a_shell(name: str) -> None:
    assert shlex.split(in_shell(name)) == [name]
