"""How precisely a receiver sees a field; compared with what the real guard sends."""

import math
import struct
from collections.abc import Callable
from typing import Literal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from grants.decision import Decision
from grants.errors import GrantError
from grants.guard import Guard
from grants.model import Restriction, Right, filter_rules
from grants.policy.assertion_check import Visibility
from grants.policy.decision import Decider, Verdict
from grants.policy.model import Clause, Effect
from rossec.authority.policyfile import layout_of
from tests.grants.policy.policies import node, policy

POSE = layout_of("geometry_msgs/PoseStamped")
X = "pose.position.x"


def sight(*filters: str, topic_type: str = "geometry_msgs/PoseStamped") -> Visibility:
    """That of a receiver under one rule for each of `filters`."""
    listed = (
        "".join(
            f"\n  - {{id: r{number}, who: /a, allow: {{subscribe: /t}}, filter: {each}}}"
            for number, each in enumerate(filters)
        )
        or "\n  - {id: r, who: /a, allow: {subscribe: /t}}"
    )
    read = policy(f"rossec: 1\nrobot: r\ntypes: {{/t: {topic_type}}}\nrules:{listed}\n")
    verdict = Decider(read).decide(node("/a"), Right.SUBSCRIBE, "/t")
    return Visibility(layout_of(topic_type), verdict)


def test_without_a_filter_everything_is_exact() -> None:
    plain = sight()
    for path in (X, "header.stamp", "header.frame_id", "header.seq"):
        assert plain.is_exact(path)
        assert not plain.is_hidden(path)
    assert not plain.is_no_finer_than(X, 1e-6)


def test_a_grid_is_no_finer_than_its_step() -> None:
    grid = sight("{pose.position: {round: 2.0}}")
    assert grid.is_no_finer_than(X, 2.0)
    assert grid.is_no_finer_than("pose.position.z", 1.5)
    assert not grid.is_no_finer_than(X, 2.01)
    assert not grid.is_exact(X)
    assert not grid.is_hidden(X)
    assert not grid.is_no_finer_than("header.stamp", 1.0)


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 400), st.integers(1, 400))
def test_the_step_is_the_border(step: int, asked: int) -> None:
    grid = sight(f"{{pose.position.x: {{round: {step / 8}}}}}")
    assert grid.is_no_finer_than(X, asked / 8) is (asked <= step)


def test_hysteresis_makes_no_cell_narrower() -> None:
    grid = sight("{pose.position: {round: {step: 2.0, hysteresis: 0.5}}}")
    assert grid.is_no_finer_than(X, 2.0)
    assert not grid.is_no_finer_than(X, 4.1)


def test_a_range_is_exact_within() -> None:
    clamped = sight("{pose.position.x: {clamp: [-5, 5]}}")
    assert not clamped.is_no_finer_than(X, 0.1)
    assert not clamped.is_exact(X)
    far = sight("{pose.position.x: {clamp: [1000.0, 1001.0]}}")
    assert not far.is_no_finer_than(X, 0.5), "around zero it is constant"


def test_what_is_set_or_cleared_is_hidden() -> None:
    hidden = sight("{pose.position: {clear: true}, header.frame_id: {redact: map}}")
    assert hidden.is_hidden(X)
    assert hidden.is_hidden("header.frame_id")
    assert hidden.is_no_finer_than(X, 1e9)
    assert not hidden.is_hidden("pose.orientation.w")


def test_rules_hold_together() -> None:
    both = sight("{pose.position: {round: 2.0}}", "{pose.position.x: {round: 3.0}}")
    assert both.is_no_finer_than("pose.position.y", 2.0)
    assert not both.is_no_finer_than(X, 3.0), "a grid on a grid has narrow cells"


def test_a_pseudonym_tells_who_is_the_same() -> None:
    found = sight("{header.frame_id: {hash: people}}")
    assert not found.is_hidden("header.frame_id")
    assert not found.is_exact("header.frame_id")


def test_times_and_integers_are_measured_too() -> None:
    found = sight("{header.stamp: {round: 10}, header.seq: {round: 8}}")
    assert found.is_no_finer_than("header.stamp", 10)
    assert not found.is_no_finer_than("header.stamp", 11)
    assert found.is_no_finer_than("header.seq", 8)
    assert not found.is_no_finer_than("header.seq", 9)


@pytest.mark.parametrize(("asked", "holds"), [(0.5, True), (0.6, False)])
def test_elements_of_arrays_are_measured(asked: float, *, holds: bool) -> None:
    scan = sight("{ranges: {round: 0.5}}", topic_type="sensor_msgs/LaserScan")
    assert scan.is_no_finer_than("ranges", asked) is holds
    dropped = sight("{ranges: {drop: true}}", topic_type="sensor_msgs/LaserScan")
    assert dropped.is_hidden("ranges")


def test_filters_that_refuse_what_is_tried_tell_nothing() -> None:
    image = sight("{data: {pixelate: 8}}", topic_type="sensor_msgs/Image")
    with pytest.raises(GrantError):
        image.is_hidden("data")


# --- what samples believed, and what the guard sends ---


@pytest.mark.parametrize(
    ("field", "rule", "kind"),
    [
        ("header.stamp", "{round: 3600}", "geometry_msgs/PoseStamped"),
        ("header.stamp", "{round: 1e9}", "geometry_msgs/PoseStamped"),
        (X, "{round: 5000}", "geometry_msgs/PoseStamped"),
        (X, "{round: 1e308}", "geometry_msgs/PoseStamped"),
        (X, "{clamp: [1e6, 1e7]}", "geometry_msgs/PoseStamped"),
        (X, "{clamp: [0, 0]}", "geometry_msgs/PoseStamped"),
        ("header.seq", "{round: 4000000}", "geometry_msgs/PoseStamped"),
        ("header.seq", "{clamp: [4294967294, 4294967295]}", "geometry_msgs/PoseStamped"),
        ("data", "{clamp: [9007199254740990, 9007199254740991]}", "std_msgs/Int64"),
        ("data", "{round: 9000000000000000000}", "std_msgs/UInt64"),
        ("data", "{round: 127}", "std_msgs/Int8"),
        ("data", "{truncate: 1}", "std_msgs/String"),
    ],
)
def test_what_shows_large_values_is_not_hidden(field: str, rule: str, kind: str) -> None:
    found = sight(f"{{{field}: {rule}}}", topic_type=kind)
    assert not found.is_hidden(field)
    assert not found.is_exact(field)


def test_a_range_of_one_value_is_hidden() -> None:
    for low in (1, -7.5):
        assert sight(f"{{{X}: {{clamp: [{low}, {low}]}}}}").is_hidden(X)
    both = sight(f"{{{X}: {{clamp: [-1, 1]}}}}", f"{{{X}: {{round: 8}}}}")
    assert both.is_no_finer_than(X, 8)


@pytest.mark.parametrize("far", ["1e6, 1e6", "1000000.0, 1000001.0", "-1e9, -1e8"])
def test_a_range_far_away_is_as_fine_as_one_near(far: str) -> None:
    assert sight(f"{{{X}: {{clamp: [{far}]}}}}").is_no_finer_than(X, 0.5) is (far == "1e6, 1e6")


def test_a_field_that_a_condition_reads_is_neither_hidden_nor_coarse() -> None:
    text = f"msg.{X} < 5"
    read = policy(
        "rossec: 1\nrobot: r\ntypes: {/t: geometry_msgs/PoseStamped}\nrules:\n"
        f"  - {{id: r, who: /a, allow: {{subscribe: /t}}, when: {text!r},"
        " filter: {pose.position: {clear: true}}}\n"
    )
    found = Visibility(POSE, Decider(read).decide(node("/a"), Right.SUBSCRIBE, "/t"))
    assert not found.is_hidden(X)
    assert not found.is_no_finer_than(X, 0.1)
    assert found.is_hidden("pose.position.y")


NUMBERS = {
    "std_msgs/Float64": "d",
    "std_msgs/Float32": "f",
    "std_msgs/Int8": "b",
    "std_msgs/UInt8": "B",
    "std_msgs/Int16": "h",
    "std_msgs/UInt32": "I",
    "std_msgs/Int64": "q",
    "std_msgs/UInt64": "Q",
}


def _limits(code: str) -> tuple[int, int]:
    bits = 8 * struct.calcsize(code)
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if code.islower() else (0, (1 << bits) - 1)


@st.composite
def chains(draw: st.DrawFn) -> tuple[str, list[dict[str, object]], list[float]]:
    """A type of one number, filters of several rules on it, and values near what they name."""
    kind = draw(st.sampled_from(sorted(NUMBERS)))
    code = NUMBERS[kind]
    floats = code in "fd"
    low, high = (-1e9, 1e9) if floats else _limits(code)
    width: Literal[32, 64] = 32 if code == "f" else 64
    any_value = (
        st.floats(width=width) if floats else st.integers(int(low), int(high))
    )  # NaN and infinities among them
    bound = st.floats(low, high, width=width) if floats else any_value
    step = st.floats(0.015625, 1e6, width=32) if floats else st.integers(1, min(_limits(code)[1], 10**9))
    rules: list[dict[str, object]] = []
    near: list[float] = []
    for _ in range(draw(st.integers(0, 3))):
        if draw(st.booleans()):
            size = draw(step)
            rules.append({"round": {"step": size}})
            near += [size / 2, -size / 2, 1.5 * size] if floats else [int(size) // 2, int(size)]
        else:
            ends = sorted((draw(bound), draw(bound)))
            rules.append({"clamp": {"low": ends[0], "high": ends[draw(st.integers(0, 1))]}})
            near += ends
    inside = [each for each in near if low <= each <= high]
    values = draw(st.lists(any_value, min_size=3, max_size=10))
    return kind, rules, [*values, *inside]


@settings(max_examples=150, deadline=None)
@given(chains(), st.floats(0.015625, 1e6))
def test_what_is_said_is_what_the_guard_does(
    chain: tuple[str, list[dict[str, object]], list[float]], asked: float
) -> None:
    kind, rules, values = chain
    code, layout = NUMBERS[kind], layout_of(kind)
    given_by = tuple(Restriction(kind, (), filter_rules({"data": each})) for each in rules)
    clauses = tuple(Clause(Right.SUBSCRIBE, "/t", each) for each in given_by)
    verdict = Verdict(Effect.ALLOW, node("/a"), Right.SUBSCRIBE, "/t", clauses=clauses)
    said = Visibility(layout, verdict)
    guard = Guard(layout, Decision(Right.SUBSCRIBE, "/t", (), 1 << 40, verdict.restrictions))

    def sent(value: float) -> bytes:
        pieces = guard.apply(struct.pack(f"<{code}", value), 0)
        assert pieces is not None
        return b"".join(pieces)

    if said.is_hidden("data"):
        assert len({sent(value) for value in values}) == 1
    elif said.is_exact("data"):
        assert all(sent(value) == struct.pack(f"<{code}", value) for value in values)
    if said.is_no_finer_than("data", asked) and code in "dhIb":
        for value in values:
            if math.isfinite(value) and abs(value) < 1e8:
                assert _is_wide(sent, value, asked, code)


def _is_wide(sent: Callable[[float], bytes], value: float, size: float, code: str) -> bool:
    """Whether the values that become the same as this one lie in an interval of nearly `size`."""
    low, high = (-math.inf, math.inf) if code in "fd" else _limits(code)
    whole = code not in "fd"
    kept = sent(value)
    reach = [value, value]
    for side, sign in enumerate((-1, 1)):
        same, other = 0.0, size
        for _ in range(60):
            offset = (same + other) / 2
            at = value + sign * (math.floor(offset) if whole else offset)
            if not low <= at <= high:
                same = size  # cut off by the range of the type
                reach[side] = value + sign * size
                break
            if sent(at) == kept:
                same = offset
                reach[side] = at
            else:
                other = offset
    return reach[1] - reach[0] + (1 if whole else 0) >= size * (1 - 1e-5) - 1e-9 * abs(value)
