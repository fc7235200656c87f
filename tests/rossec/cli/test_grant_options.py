"""`rossec grant`: what its options make of a restriction, tried on the message type at once."""

import pytest

from grants.errors import FilterRefused
from grants.model import Restriction, Right, filter_rules
from rossec.cli.grant import _permissions, _restrictions, _rules
from rossec.cli.main import run
from rossec.errors import ConfigurationError

POSE = "geometry_msgs/PoseStamped"


def test_options() -> None:
    rules = _rules(("header.frame_id",), ("pose.position=0.5",), ("pose.orientation=-1:0.5",))
    [made] = _restrictions(POSE, rules, ("msg.header.seq > 1",), 2.5, None)
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
    assert _restrictions(None, {}, (), None, None) == []


def test_a_preset_and_more_hold_together() -> None:
    made = _restrictions(
        POSE, _rules((), (), ()), ("now.getHours() >= 8",), None, "coarse-position"
    )
    assert [item.rate for item in made] == [0.2, None]
    permissions = _permissions(("/out",), ("/pose", "/other"), True, made)
    assert [permission.restriction for permission in permissions] == [None, *made, *made, None]
    assert [item.rights for item in _permissions((), ("/a",), False, [])] == [Right.SUBSCRIBE]


def test_mistakes_show_at_once() -> None:
    with pytest.raises(FilterRefused, match="no field 'positon'"):
        _restrictions(POSE, _rules((), ("pose.positon=1",), ()), (), None, None)
    with pytest.raises(FilterRefused, match="the preset does not exist for std_msgs/String"):
        _restrictions("std_msgs/String", {}, (), None, "coarse-position")
    with pytest.raises(ConfigurationError, match="need the message type"):
        _restrictions(None, {}, (), 1.0, None)
    for text in ("x", "x=1", "x=a:b"):
        with pytest.raises(ConfigurationError, match=f"--clamp {text} has no range"):
            _rules((), (), (text,))
    with pytest.raises(ConfigurationError, match="what a subscriber sees"):
        _permissions(("/a",), (), False, [Restriction(rate=1)])


def test_presets_are_explained(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["grant", "presets"], {}) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "coarse-position"
    assert lines[1].startswith("  hides the place within cells of 2 m")
    assert lines[2].startswith("  still tells the room")
