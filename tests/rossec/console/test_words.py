"""What filters, rights and spans of time are called."""

import pytest

from grants.filters.operators import OPERATORS
from grants.model import FilterRule, Restriction, Right, Scalar, filter_rules
from rossec.console import words
from tests.support.consolehome import COARSE, HOSTILE

EXAMPLES: dict[str, tuple[dict[str, Scalar], str]] = {
    "clear": ({}, "without position"),
    "drop": ({}, "without position"),
    "zero": ({}, "position blanked out"),
    "round": ({"step": 2.0}, "position to 2 m"),
    "clamp": ({"low": 0, "high": 1.5}, "position between 0 and 1.5 m"),
    "set": ({"value": True}, "position always yes"),
    "redact": ({"text": "somewhere"}, "position replaced by “somewhere”"),
    "truncate": ({"length": 3}, "only the first 3 of position"),
    "hash": ({"key": "diagnostics"}, "position as a pseudonym"),
    "pixelate": ({"block": 32, "levels": 8}, "position in squares of 32 pixels, 8 shades of grey"),
    "rooms": ({"field": "0 0, 1 1", "width": "1 1, 2 2"}, "position as the room alone"),
    "sort": ({}, "position in no order of their own"),
}


def test_every_operator_of_words_is_one_of_filters_and_has_an_example() -> None:
    assert words.OPERATORS.keys() == OPERATORS.keys() == EXAMPLES.keys()


@pytest.mark.parametrize("operator", sorted(EXAMPLES))
def test_a_filter_rule_in_words(operator: str) -> None:
    parameters, text = EXAMPLES[operator]
    assert words.filter_rule(FilterRule("pose.position", operator, tuple(parameters.items()))) == text


def test_a_name_of_another_origin_is_shown_by_its_label() -> None:
    assert words.name("/remote/hospital/rounds/robot3") == "hospital:/rounds/robot3"
    assert words.name("/rounds/robot3") == "/rounds/robot3"
    assert words.name("/remote") == "/remote"


def test_every_right_has_words() -> None:
    assert set(words.RIGHTS) == set(Right)
    assert words.rights(Right.SUBSCRIBE | Right.PUBLISH) == "send and see"


def test_a_restriction_says_the_most_important_first() -> None:
    assert words.restrictions([COARSE]) == ("position to 2 m, without direction, without the map's name")
    limited = Restriction(None, ("now < 5",), (), 0.2)
    assert words.restriction(limited) == ["at most one every 5 s", "only when now < 5"]
    assert words.restriction(Restriction(slot=60)) == ["one at the start of each 60 s"]
    assert words.rate(3) == "at most 3 a second"


def test_a_level_of_the_vocabulary_is_said_first() -> None:
    steps = {"round": {"step": 4.0, "hysteresis": 2.0}}
    rules = filter_rules({"pose.position": steps, "pose.orientation": {"clear": True}})
    room = Restriction("geometry_msgs/PoseStamped", (), rules, 1 / 30)
    assert words.restrictions([room]) == (
        "where it is: the room; how it moves: only by where it is"
        " (position to 4 m, without direction, at most one every 30 s)"
    )
    unknown = Restriction("my_msgs/Own", (), filter_rules({"a": {"clear": True}}))
    assert words.levels([unknown]) == words.levels([]) == words.levels([COARSE]) == ""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('msg.header.frame_id == "living_room"', "the map's name is “living_room”"),
        ("msg.header.frame_id != 'a'", "the map's name is not “a”"),
        ("msg.percentage < 0.2", "charge is below 0.2"),
        ("msg.pose.position.z >= -1", "height is at least -1"),
        ("msg.a > 1 && msg.b < 2", "msg.a > 1 && msg.b < 2"),
        ("now < 5", "now < 5"),
        ('msg.a == "' + HOSTILE.replace('"', "") + '"', None),
    ],
)
def test_a_condition_on_one_field_is_in_words(text: str, said: str | None) -> None:
    shown = words.condition(text)
    assert "\u202e" not in shown
    if said is not None:
        assert shown == said


def test_degrees_are_said_in_metres_too() -> None:
    rule = FilterRule("latitude", "round", (("step", 0.001),))
    assert words.filter_rule(rule) == "latitude to 0.001 degrees (about 111 m)"


def test_a_region_and_a_picture_are_named() -> None:
    rules = filter_rules({"data": {"pixelate": {"block": 8, "x": 0, "y": 0, "width": 9, "height": 9}}})
    assert words.filters(rules, "sensor_msgs/Image") == [
        "picture in squares of 8 pixels, only in a part of it"
    ]
    across = filter_rules({"data": {"pixelate": {"across": 16, "levels": 8}}})
    assert words.filters(across, "sensor_msgs/Image") == [
        "picture in squares, at most 16 across, 8 shades of grey"
    ]


def test_a_field_name_is_the_longest_known_end_or_the_path() -> None:
    assert words.field_name("pose.pose.position") == "position"
    assert words.field_name("a.header.frame_id") == "the map's name"
    assert words.field_name("cells[*].some_thing") == "cells.some thing"
    assert words.field_name("data", "std_msgs/String") == "text"


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (59, "less than a minute"),
        (60, "1 minute"),
        (7200, "2 hours"),
        (86400 * 40, "40 days"),
        (86400 * 800, "2 years"),
    ],
)
def test_a_duration_is_its_largest_unit(seconds: int, text: str) -> None:
    assert words.duration(seconds) == text
    assert words.left(seconds, 0) == f"{text} left"


def test_a_day_of_which_seconds_are_over_is_a_day() -> None:
    assert words.left(86400 - 5, 0) == "1 day left"
    assert words.left(7 * 86400 - 70, 0) == "7 days left"
    assert words.left(23 * 3600, 0) == "23 hours left"


def test_what_is_over_is_not_left() -> None:
    assert words.left(5, 5) == "over"
    assert words.ago(100, 90) == "just now"
    assert words.ago(0, 3600) == "1 hour ago"


def test_the_term_of_a_grant_that_is_renewed_ends_with_its_cap() -> None:
    assert words.term(3600, 3600, 0) == "1 hour left"
    assert words.term(3600, 86400, 0) == "renewed by itself, 1 day left"
    assert words.term(3600, 86400, 90000) == "over"


def test_a_list_is_bounded() -> None:
    assert words.listing(["a"]) == "a"
    assert words.listing("abc") == "a, b and c"
    assert words.listing("abcdefg") == "a, b, c, d and 3 more"


def test_a_pattern_in_words() -> None:
    assert words.topic("/**") == "everything"
    assert words.topic("/robot/**") == "everything below /robot"
    assert words.topic("/robot/*/x") == "/robot/*/x"
    assert words.topic("/rviz~/marker") == "/rviz_…/marker"
    assert words.topic("/rviz~/**") == "everything below /rviz_…"


def test_a_hostile_text_is_bounded_and_on_one_line() -> None:
    shown = words.name(HOSTILE)
    assert len(shown) < 140
    assert "\u202e" not in shown
    rule = FilterRule("pose.position", "redact", (("text", HOSTILE),))
    assert "\u202e" not in words.filter_rule(rule)
