"""Fields that are open beside a filtered one."""

import pytest

from tests.grants.policy.lint_cases import codes, findings, messages, text_of
from tests.grants.policy.lint_leaks import FIELDS, LIMIT, POSE, TIMES, Leak, filtered, pose

HINTS = {
    "velocity": "add twist: {clear: true}",
    "velocity beside a cleared position": "add twist: {clear: true}",
    "velocity of joints": "add velocity: {clear: true}, effort: {clear: true}",
    "orientation": "add pose.orientation: {clear: true}",
    "covariance": "add pose.covariance: {clear: true}",
    "stamps": "add header.stamp: {round: 60}",
    "counts": "add header.seq: {clear: true}",
    "one coordinate": "add pose.position.y: {clear: true}",
    "names that occur once": 'add "status[*].name": {clear: true}',
}


@pytest.mark.parametrize("leak", FIELDS, ids=lambda leak: leak.name)
def test_what_to_add(leak: Leak) -> None:
    assert [item.hint for item in findings(text_of(*leak.rules))] == [HINTS[leak.name]]


def test_each_related_field_is_named_once() -> None:
    assert codes(filtered("/odom", POSE, f", {LIMIT}")) == [
        "covariance-open",
        "heading-open",
        "movement-open",
        "time-open",
    ]
    found = messages(filtered("/odom", POSE, f", {LIMIT}"))
    assert len(found) == 5  # a stamp and a count
    assert (
        "rule a: pose.pose.position of /odom is filtered, twist is not: the exact path follows from"
        " it by integration"
    ) in found


def test_a_cleared_position_has_no_cells_to_change() -> None:
    cleared = filtered("/pose", "pose: {clear: true}")
    assert codes(cleared) == []


def test_a_height_indoors_may_stay() -> None:
    xy = "pose.position.x: {clear: true}, pose.position.y: {clear: true}"
    assert codes(filtered("/pose", f"{xy}, pose.orientation: {{clear: true}}, {TIMES}")) == []


def test_altitude_outdoors_may_not() -> None:
    found = codes(
        filtered(
            "/fix", "latitude: {clear: true}, longitude: {clear: true}, position_covariance: {clear: true}"
        )
    )
    assert found == ["position-open"]


def test_what_does_nothing_filters_nothing() -> None:
    assert codes(pose("{clamp: [-9, 9]}", "header.seq: {clear: true}")) == ["clamp-keeps-values"]
