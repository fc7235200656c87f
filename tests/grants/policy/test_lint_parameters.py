"""Missing parameters, and parameters that do nothing; what is suggested is what the type takes."""

import pytest

from tests.grants.policy.lint_cases import codes, findings, text_of
from tests.grants.policy.lint_leaks import (
    CELLS,
    COARSE,
    LIMIT,
    PARAMETERS,
    REST,
    SECOND,
    SQUARES,
    TIMES,
    Leak,
    also,
    filtered,
    pose,
)

REST_OF_FIX = "longitude: {clear: true}, altitude: {clear: true}, position_covariance: {clear: true}, "
HINTS = {
    "no hysteresis": "write pose.position: {round: {step: 2.0, hysteresis: 1.0}}",
    "no rate": "add limit: {rate: 0.03}",
    "nothing but that it was sent, at the full rate": "add limit: {rate: 0.03}",
    "NavSatFix without hysteresis": "write latitude: {round: {step: 0.01, hysteresis: 0.005}}",
    "NavSatFix without rate": "add limit: {rate: 0.03}",
    "ranges of a scan": "write ranges: {clear: true}",
    "points of a plan": 'write "poses[*].pose": {clear: true}',
    "a rate of 10 for a topic of 10": "add limit: {rate: 0.03}",
    "a hysteresis of a millimetre": "write pose.position: {round: {step: 2.0, hysteresis: 1.0}}",
    "/odom at a millimetre": "write pose.pose.position: {round: {step: 4.0, hysteresis: 2.0}}",
    "joints at a milliradian": "write position: {round: 0.5}",
    "squares of 4 pixels": "write data: {pixelate: {across: 16, block: 32, levels: 8}}",
    **{
        f"squares of {size} pixels": (
            f"write data: {{pixelate: {{across: 16, block: {max(size, 32)}, levels: 8}}}}"
        )
        for size in (16, 24, 32, 100)
    },
    "forty squares across": "write data: {pixelate: {across: 16, block: 32, levels: 8}}",
    "a region alone": "write data: {pixelate: {across: 16, block: 32, levels: 8}}",
    "every picture in squares": "add limit: {rate: 0.03}",
    "squares of colours": "write data: {pixelate: {across: 16, levels: 8}}",
    "squares of a hundred greys": "write data: {pixelate: {across: 20, levels: 8}}",
    "rooms without a rate": "add limit: {rate: 0.03}",
    "rooms without hysteresis": 'write pose.position: {rooms: {hall: "0 0, 4 3", kitchen: "4 0, 9'
    ' 3", hysteresis: 0.5}}',
    "clamped": "write pose.position: {round: {step: 4.0, hysteresis: 2.0}}",
}


@pytest.mark.parametrize("leak", PARAMETERS, ids=lambda leak: leak.name)
def test_what_to_write(leak: Leak) -> None:
    assert findings(text_of(*leak.rules))[0].hint == HINTS[leak.name]


@pytest.mark.parametrize(
    ("topic", "fields"),
    [
        ("/scan", "ranges: {round: 1}"),
        ("/particles", "poses[*].position: {round: 2}"),
        ("/plan", "poses[*].pose: {round: 2}"),
        ("/joints", "position: {round: 0.5}"),
    ],
)
def test_hysteresis_in_an_array_is_never_advised(topic: str, fields: str) -> None:
    """The specification refuses it (grant.md 6.1)."""
    for item in findings(text_of(filtered(topic, fields))):
        assert "hysteresis" not in item.hint


@pytest.mark.parametrize(
    ("limit", "code"),
    [("", ["no-rate"]), (", limit: {rate: 2.5}", ["rate-does-nothing"]), (", limit: {rate: 2}", [])],
)
def test_rates(limit: str, code: list[str]) -> None:
    assert codes(filtered("/pose", f"pose.position: {CELLS}, {REST}", limit)) == code


def test_a_rate_of_another_rule_counts() -> None:
    slow = "id: b, who: '*', allow: {subscribe: [/pose]}, limit: {rate: 1}"
    assert codes(filtered("/pose", f"pose.position: {CELLS}, {REST}"), slow) == []


def test_a_slot_needs_no_rate() -> None:
    assert codes(also("/words", ", filter: {use: presence-only}")) == []


@pytest.mark.parametrize(
    ("topic", "field", "rest", "step", "code"),
    [
        ("/fix", "latitude", REST_OF_FIX, 0.00009, "position-open step-does-nothing"),
        ("/cmd_vel", "linear", "", 0.01, "step-does-nothing"),
        ("/pose", "header.stamp", "", 0.01, "step-does-nothing"),
        ("/cmd_vel", "linear", "", 0.5, ""),
        ("/pose", "header.stamp", "", 1, ""),
    ],
)
def test_steps_by_what_sensors_err(topic: str, field: str, rest: str, step: float, code: str) -> None:
    rule = filtered(topic, f"{rest}{field}: {{round: {step:f}}}", f", {LIMIT}")
    assert codes(rule) == code.split()


def test_what_another_rule_hides_needs_no_parameter() -> None:
    assert (
        codes(
            filtered("/pose", "pose: {clear: true}"),
            also("/pose", ", filter: {pose.position: {round: 0.001}}"),
        )
        == []
    )


def test_a_hysteresis_of_another_rule_counts() -> None:
    again = also("/pose", f", filter: {{pose.position: {{round: 4}}, {TIMES}}}")
    assert codes(COARSE, again) == []


def test_a_region_of_a_picture_becomes_the_whole() -> None:
    region = "data: {pixelate: {block: 99, x: 1, y: 2, width: 3, height: 4}}"
    [finding] = findings(text_of(filtered("/camera", region, SECOND)))
    assert finding.hint == "write data: {pixelate: {across: 16, block: 99, levels: 8}}"
    whole = filtered("/camera", f"data: {SQUARES}", SECOND).replace("id: a", "id: b")
    assert (
        codes(filtered("/camera", region.replace("block: 99", "across: 9, levels: 8"), SECOND), whole) == []
    )


def test_a_step_for_a_whole_pose_is_measured_by_its_position() -> None:
    found = codes(pose("{round: 2}", "pose.orientation: {round: 0.5}, " + TIMES))
    assert found == ["no-hysteresis"]
