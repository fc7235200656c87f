"""`rossec grant`: what its options make of a restriction, tried on the message type at once."""

from typing import Any

import click
import pytest
from click.testing import CliRunner

from ca.errors import PatternRefused
from grants.errors import FilterRefused
from grants.filters.compile import PRESETS
from grants.model import Permission, Restriction, Right, filter_rules
from rossec.cli.grant.sign import (
    for_node,
    own_pattern,
    permission_options,
    permissions,
    read_permissions,
    restrictions,
    rules,
)
from rossec.cli.main import run
from rossec.errors import ConfigurationError

POSE = "geometry_msgs/PoseStamped"


def test_options() -> None:
    filters = rules(("header.frame_id",), ("pose.position=0.5",), ("pose.orientation=-1:0.5",))
    [made] = restrictions(POSE, filters, ("msg.header.seq > 1",), 2.5, None)
    assert made == Restriction(
        POSE,
        ("msg.header.seq > 1",),
        filter_rules(
            {
                "header.frame_id": {"clear": True},
                "pose.position": {"round": {"step": 0.5}},
                "pose.orientation": {"clamp": {"low": -1, "high": 0.5}},
            }
        ),
        2.5,
    )
    assert restrictions(None, {}, (), None, None) == []


def test_a_preset_and_more_hold_together() -> None:
    made = restrictions(POSE, rules((), (), ()), ("now.getHours() >= 8",), None, "coarse-position")
    assert [item.rate for item in made] == [None, None]
    wanted = {Right.PUBLISH: ("/out",), Right.SUBSCRIBE: ("/pose", "/other"), Right.CALL: ("/go",)}
    granted = permissions(wanted, graph=True, restricted=made)
    assert [item.restriction for item in granted] == [None, *made, *made, *made, None]
    assert [item.rights for item in granted][-3:] == [Right.CALL, Right.CALL, Right.GRAPH]
    alone = permissions({Right.SUBSCRIBE: ("/a",)}, graph=False, restricted=[])
    assert [item.rights for item in alone] == [Right.SUBSCRIBE]


def test_a_part_of_a_service_may_be_restricted() -> None:
    [made] = restrictions("std_srvs/SetBoolRequest", {}, ("msg.data == false",), None, None)
    assert made.type == "std_srvs/SetBoolRequest"


def test_invalid_options_are_refused() -> None:
    with pytest.raises(FilterRefused, match="no field 'positon'"):
        restrictions(POSE, rules((), ("pose.positon=1",), ()), (), None, None)
    with pytest.raises(FilterRefused, match="the preset does not support std_msgs/String"):
        restrictions("std_msgs/String", {}, (), None, "coarse-position")
    with pytest.raises(ConfigurationError, match="need the message type"):
        restrictions(None, {}, (), 1.0, None)
    for text in ("x", "x=1", "x=a:b"):
        with pytest.raises(ConfigurationError, match=f"--clamp {text} has no range"):
            rules((), (), (text,))
    with pytest.raises(ConfigurationError, match="what a subscriber sees"):
        permissions({Right.PUBLISH: ("/a",)}, graph=False, restricted=[Restriction(rate=1)])


def test_presets_are_explained(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["grant", "presets"], {}) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "coarse-position"
    assert lines[1].startswith("  hides the place within cells of 4 m")
    assert lines[2].startswith("  still discloses the part of the home")


def test_wishes_are_options_and_read_says_what_they_mean() -> None:
    found: list[tuple[Permission, ...]] = []

    @click.command()
    @permission_options
    def ask(**said: Any) -> None:
        found.append(read_permissions(said))

    options = (
        "--subscribe",
        "/pose",
        "--type",
        POSE,
        "--round",
        "pose.position=0.5",
        "--rate",
        "2",
        "--clear",
        "header.frame_id",
        "--graph",
    )
    assert CliRunner().invoke(ask, options, catch_exceptions=False).exit_code == 0
    [[seen, *graph]] = found
    assert (seen.pattern, seen.rights) == ("/pose", Right.SUBSCRIBE)
    assert seen.restriction is not None
    assert [rule.path for rule in seen.restriction.filters] == ["header.frame_id", "pose.position"]
    assert seen.restriction.rate == 2
    assert [item.rights for item in graph] == [Right.GRAPH]


def test_read_without_a_right_is_refused() -> None:
    @click.command()
    @permission_options
    def ask(**said: Any) -> None:
        read_permissions(said)

    with pytest.raises(ConfigurationError):
        CliRunner().invoke(ask, (), catch_exceptions=False)


def test_own_names_are_those_of_the_node() -> None:
    said = {str(right.name).lower(): () for right in Right} | {"provide": ("{node}/a", "/b")}
    made = for_node({**said, "rate": 1}, "/rviz", lambda: True)
    assert (made["provide"], made["rate"]) == (("/rviz~/a", "/b"), 1)
    assert for_node(said, "/robot", lambda: False)["provide"] == ("/robot/a", "/b")
    asked: list[bool] = []
    plain = said | {"provide": ("/b",)}
    assert for_node(plain, "/robot", lambda: asked == [True]) == plain
    assert asked == []
    for text in ("/x{node}", "~a", "~"):
        with pytest.raises(PatternRefused):
            own_pattern(text, "/robot", tail=False)
    with pytest.raises(PatternRefused, match="no name of /remote/lab/robot"):
        own_pattern("{node}/a", "/remote/lab/robot", tail=False)


@pytest.mark.attack("two-spellings")
@pytest.mark.parametrize(
    ("clear", "rounds", "clamps"),
    [
        (("x",), ("x=2",), ()),
        (("x",), (), ("x=0:1",)),
        ((), ("x=2", "x=0.001"), ()),
        ((), ("x=2",), ("x=0:1",)),
    ],
)
def test_of_two_filters_for_one_field_none_is_lost(
    clear: tuple[str, ...], rounds: tuple[str, ...], clamps: tuple[str, ...]
) -> None:
    with pytest.raises(ConfigurationError, match="x: 2 filters for one field"):
        rules(clear, rounds, clamps)


@pytest.mark.attack("two-spellings")
@pytest.mark.parametrize(
    "said",
    [
        ("--rate", "1", "--rate", "50"),
        ("--preset", "coarse-position", "--preset", [*PRESETS][-1]),
        ("--type", POSE, "--type", "std_msgs/String"),
    ],
)
def test_a_restriction_is_not_replaced_by_a_second_one(said: tuple[str, ...]) -> None:
    @click.command()
    @permission_options
    def command(**_: Any) -> None:
        raise AssertionError("not called")

    done = CliRunner().invoke(command, said)
    assert done.exit_code == 2
    assert "given more than once" in done.output
