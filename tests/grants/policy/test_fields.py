"""Filters and conditions in the notation of a policy."""

import pytest

from grants.filters.layout import parse
from grants.policy.restrictions import (
    check_condition,
    check_fields,
    check_preset,
    read_condition,
    read_fields,
    suggest_field,
)
from grants.policy.source import Mistakes, YamlMapping, YamlScalar, YamlSequence, read_source
from tests.grants.policy.policies import definition

POSE = parse("geometry_msgs/PoseStamped", definition("geometry_msgs/PoseStamped"))
STATUS = parse("diagnostic_msgs/DiagnosticArray", definition("diagnostic_msgs/DiagnosticArray"))
MISTAKES = Mistakes("p.yaml")
HERE = YamlScalar(5, 5, MISTAKES, "")


@pytest.fixture
def mistakes() -> Mistakes:
    MISTAKES.found.clear()
    return MISTAKES


def table(text: str) -> YamlMapping:
    part = read_source(text, MISTAKES)
    assert isinstance(part, YamlMapping)
    return part


def rule(text: str) -> str | None:
    rules = read_fields(table(f"a: {text}"))
    return str(rules[0].rule) if rules else None


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("{clear: true}", "a: clear"),
        ("{round: 0.5}", "a: round step 0.5"),
        ("{round: {step: 2}}", "a: round step 2"),
        ("{clamp: [1, 2.5]}", "a: clamp high 2.5 low 1"),
        ("{clamp: {low: 1, high: 2}}", "a: clamp high 2 low 1"),
        ('{redact: "***"}', "a: redact text ***"),
        ("{truncate: [5]}", "a: truncate length 5"),
        ("{set: true}", "a: set value True"),
    ],
)
def test_short_and_long_forms(text: str, expected: str, mistakes: Mistakes) -> None:
    assert rule(text) == expected
    assert mistakes.found == []


@pytest.mark.parametrize(
    ("text", "message", "hint"),
    [
        ("5", "a: exactly one operator per field", "for example {round: 0.5} or {clear: true}"),
        ("{clear: true, drop: true}", "a: exactly one operator per field", "for example"),
        ("{cleer: true}", "a: unknown operator 'cleer'", "did you mean 'clear'?"),
        ("{clear: false}", "a: invalid parameters of clear", "write {clear: true}"),
        ("{clear: {}}", "a: invalid parameters of clear", "write {clear: true}"),
        ("{round: [1, 2]}", "a: invalid parameters of round", "write {round: STEP} or"),
        ("{round: {step: [1]}}", "a: invalid parameters of round", "write {round: STEP} or"),
        ("{truncate: [[5]]}", "a: invalid parameters of truncate", "write {truncate: LENGTH}"),
        ("{clamp: 5}", "a: clamp: high must", ""),
        ("{clamp: [5]}", "a: invalid parameters of clamp", "write {clamp: [LOW, HIGH]}"),
        ("{round: 0}", "a: round needs a step above zero", "for example"),
        ("{round: x}", "a: step must be a number", "write {round: STEP}"),
    ],
)
def test_a_mistake_has_position_and_hint(text: str, message: str, hint: str, mistakes: Mistakes) -> None:
    if text == "{clamp: 5}":
        message, hint = "a: high must be a number", "write {clamp: [LOW, HIGH]}"
    assert rule(text) is None
    (found,) = mistakes.found
    assert found.message.startswith(message)
    assert found.hint.startswith(hint)
    assert found.line == 1


def test_an_invalid_path_is_a_mistake(mistakes: Mistakes) -> None:
    assert read_fields(table('"a b": {clear: true}')) == ()
    assert mistakes.found[0].message == "not a field path: 'a b'"


def test_fields_are_checked_each_and_together(mistakes: Mistakes) -> None:
    good = read_fields(table("pose.position: {round: 1}\nheader.seq: {clear: true}"))
    assert check_fields(POSE, good, HERE)
    overlap = read_fields(table("pose: {clear: true}\npose.position: {round: 1}"))
    assert not check_fields(POSE, overlap, HERE)
    assert (mistakes.found[-1].line, "contains one" in mistakes.found[-1].message) == (5, True)
    wrong = read_fields(table("\n\npoze: {clear: true}"))
    assert not check_fields(POSE, wrong, HERE)
    assert (mistakes.found[-1].line, mistakes.found[-1].hint) == (3, "did you mean 'pose'?")


@pytest.mark.parametrize(
    ("text", "message"),
    [("now.getHours() >= 6", False), ("msg.header.seq > 1u", None), ("msg.header.seq > 1", True)],
)
def test_conditions_that_read_the_message(text: str, message: bool | None, mistakes: Mistakes) -> None:
    when = read_condition(YamlScalar(1, 1, MISTAKES, text))
    assert (when.reads_message if when is not None else None) is message


@pytest.mark.parametrize(
    "part",
    [
        YamlScalar(1, 1, MISTAKES, 5),
        YamlSequence(1, 1, MISTAKES, ()),
        YamlScalar(1, 1, MISTAKES, "now >"),
        YamlScalar(1, 1, MISTAKES, "5"),
    ],
)
def test_invalid_conditions_are_mistakes(part: YamlScalar | YamlSequence, mistakes: Mistakes) -> None:
    assert read_condition(part) is None
    assert len(mistakes.found) == 1


def test_conditions_are_checked_for_a_type(mistakes: Mistakes) -> None:
    good = read_condition(YamlScalar(1, 1, MISTAKES, 'msg.header.frame_id == "map"'))
    assert good is not None
    assert check_condition(POSE, good)
    misspelt = read_condition(YamlScalar(2, 2, MISTAKES, 'msg.header.frameid.startsWith("map")'))
    assert misspelt is not None
    assert not check_condition(POSE, misspelt)
    assert (mistakes.found[-1].line, mistakes.found[-1].hint) == (2, "did you mean 'frame_id'?")
    mixed = read_condition(YamlScalar(2, 2, MISTAKES, "msg.pose.position.x + 1 > 2.0"))
    assert mixed is not None
    assert not check_condition(POSE, mixed)
    assert mistakes.found[-1].hint == "write whole numbers as 2.0 beside a double"


def test_presets_are_checked_for_the_type(mistakes: Mistakes) -> None:
    assert check_preset(POSE, "coarse-position", HERE)
    assert not check_preset(STATUS, "coarse-position", HERE)
    assert (mistakes.found[0].line, "does not support" in mistakes.found[0].message) == (5, True)


@pytest.mark.parametrize(
    ("path", "hint"),
    [
        ("status[*].nam", "did you mean 'name'?"),
        ("status.values.kay", "did you mean 'key'?"),
        ("header.frame_id.x", ""),
        ("header.frame_id", ""),
    ],
)
def test_the_nearest_field(path: str, hint: str) -> None:
    assert suggest_field(STATUS, path) == hint
