"""How precisely a receiver sees a field, tried on compiled filters."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from grants.errors import GrantError
from grants.model import Right
from grants.policy.decision import Decider
from grants.policy.sight import Sight
from rossec.authority.policyfile import layout_of
from tests.grants.policy.policies import node, policy

POSE = layout_of("geometry_msgs/PoseStamped")
X = "pose.position.x"


def sight(*filters: str, topic_type: str = "geometry_msgs/PoseStamped") -> Sight:
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
    return Sight(layout_of(topic_type), verdict)


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
