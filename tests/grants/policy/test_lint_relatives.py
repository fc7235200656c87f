"""What one receiver, or one owner, sees exactly beside something coarse."""

import pytest

from tests.grants.policy.lint_cases import codes, findings, messages, text_of
from tests.grants.policy.lint_leaks import (
    COARSE,
    FOR_PHONE,
    GRID,
    LIMIT,
    OWNER,
    RELATIVES,
    REST,
    TIMES,
    Leak,
    also,
    filtered,
)


@pytest.mark.parametrize("leak", RELATIVES, ids=lambda leak: leak.name)
def test_the_line_is_that_of_a_rule(leak: Leak) -> None:
    found = findings(text_of(*leak.rules, head=leak.head, types=dict(leak.types)))
    assert sorted({item.code for item in found}) == leak.codes.split()
    assert all(item.line for item in found)


def test_which_topics_are_seen_exactly() -> None:
    assert messages(COARSE, also("/odom, /tf")) == [
        "rule coarse: /x sees /pose coarsely, but /odom exactly",
        "rule coarse: /x sees /pose coarsely, but /tf exactly",
    ]
    assert messages(COARSE, "id: b, who: /y, allow: {subscribe: [/odom, /tf]}") == []


def test_what_a_pattern_covers_is_one_remark() -> None:
    [message] = messages(COARSE, also("'/**'"))
    assert message == (
        "rule coarse: /x sees /pose coarsely, but /amcl_pose, /camera/image_raw, /cmd_vel, /fix,"
        " /odom, /scan, /tf exactly"
    )


def test_a_filter_of_another_topic_is_enough_if_it_treats_the_place() -> None:
    odom = filtered("/odom", "pose: {clear: true}, twist: {clear: true}")
    assert codes(COARSE, odom) == []
    frames = filtered("/odom", "child_frame_id: {clear: true}")
    assert codes(COARSE, frames) == ["exact-relative"]
    still = filtered("/odom", "twist: {clear: true}")
    assert codes(COARSE, still) == ["exact-relative"]


def test_pictures_are_given_away_by_pictures_and_points_in_space() -> None:
    blurred = filtered(
        "/camera", "data: {pixelate: {across: 16, block: 32, levels: 8}}", ", limit: {rate: 1}"
    )
    assert codes(blurred, also("/odom, /scan")) == []
    for other in ("/camera2", "/cloud"):
        assert codes(blurred, also(other)) == ["exact-relative"]


def test_names_are_given_away_by_the_same_type_only() -> None:
    hidden = filtered("/diagnostics", "status[*].name: {clear: true}, status[*].hardware_id: {clear: true}")
    assert codes(hidden, also("/joints")) == []


def test_the_parameter_of_localisation() -> None:
    reads = "id: b, who: /x, allow: {param-get: [/amcl]}"
    [message] = messages(COARSE, reads)
    assert message.endswith("but may read /amcl/initial_pose_x, where amcl saves the position")
    denied = "id: d, who: /x, deny: {param-get: [/amcl/initial_pose_x]}"
    assert messages(COARSE, reads, denied) == []
    assert messages(COARSE, reads.replace("/amcl", "/amcl/rate")) == []


def test_what_nothing_is_known_of() -> None:
    assert messages(COARSE, also("/secret")) == [
        "rule coarse: /x sees /pose coarsely, and /secret, of which no type is given"
    ]
    odd = {"/odd": "dynamic_reconfigure/Config"}
    [message] = messages(COARSE, also("/odd"), types=odd)
    assert message.endswith("and /odd, and of dynamic_reconfigure/Config nothing is known here")
    assert codes(also("/secret")) == []  # beside nothing that is hidden


@pytest.mark.parametrize(("other", "code"), [("tablet", ["second-receiver"]), ("/nobody", [])])
def test_receivers_of_one_key(other: str, code: list[str]) -> None:
    exact = f"id: b, who: {other}, allow: {{subscribe: [/odom]}}"
    unused = [] if other == "tablet" else ["unused-identity"]
    assert codes(FOR_PHONE, exact, head=OWNER) == sorted([*code, *unused])


@pytest.mark.parametrize(
    ("one", "other", "code"),
    [
        ("/x", "/x/app", ["second-receiver"]),
        ("/x/app", "/x", ["second-receiver"]),
        ("/x/app", "/x/nav", []),
        ("/x", "/xy", []),
        ("'h:/a'", "'h:/b'", ["second-receiver"]),
        ("'h:/a'", "'k:/b'", []),
    ],
)
def test_receivers_of_one_owner(one: str, other: str, code: list[str]) -> None:
    exact = f"id: b, who: {other}, allow: {{subscribe: [/odom]}}"
    assert codes(COARSE.replace("who: /x", f"who: {one}"), exact) == code


def test_the_message_names_both() -> None:
    exact = "id: b, who: /x/app, allow: {subscribe: [/odom]}"
    assert messages(COARSE, exact) == [
        "rule coarse: /x sees /pose coarsely, but /x/app, of the same owner, sees /odom exactly"
    ]


@pytest.mark.parametrize(
    ("step", "code"), [(2, []), (4, []), (1, []), (3, ["two-versions"]), (2.5, ["two-versions"])]
)
def test_grids_nest_or_not(step: float, code: list[str]) -> None:
    grid = f"{{round: {{step: {step}, hysteresis: {step / 2}}}}}"
    assert codes(COARSE, filtered("/goal", f"pose.position: {grid}, {REST}", f", {LIMIT}")) == code


def test_two_grids_of_one_topic_for_two_strangers() -> None:
    stranger = filtered("/pose", f"pose.position: {GRID}, {REST}", f", {LIMIT}")
    assert codes(COARSE, stranger.replace("/x", "/y")) == []


def test_one_receiver_may_have_one_key_for_two_topics() -> None:
    hashed = "status[*].name: {clear: true}, status[*].hardware_id: {hash: k}"
    types = {"/d2": "diagnostic_msgs/DiagnosticArray"}
    both = also("/diagnostics, /d2", f", filter: {{{hashed}}}")
    assert codes(both, types=types) == []


def test_the_climate_that_a_sensor_is_carried_through() -> None:
    types = {"/air": "sensor_msgs/Temperature"}
    assert codes(COARSE, also("/air"), types=types) == ["exact-relative"]
    coarse = "id: b, who: /x, allow: {subscribe: [/air]}, see: {position: room}"
    assert codes(COARSE, coarse, types=types) == []


def test_wheels_in_steps() -> None:
    cleared = "velocity: {clear: true}, effort: {clear: true}, " + TIMES
    steps = filtered("/joints", f"position: {{round: 0.5}}, {cleared}")
    assert codes(COARSE, steps) == ["wheels-open"]
    assert codes(steps) == []
    assert codes(COARSE, steps.replace("{round: 0.5}", "{clear: true}")) == []


def of_frame(topic: str, frame: str, position: str = "{round: {step: 4, hysteresis: 2}}") -> str:
    when = f"when: 'msg.header.frame_id == \"{frame}\"'"
    fields = f"pose.position: {position}, pose.orientation: {{clear: true}}, {TIMES}"
    more = f", limit: {{rate: 0.03}}, {when}"
    return filtered(topic, fields, more).replace("id: a", f"id: r{topic[1:]}")


def test_equal_grids_in_two_frames_or_plans() -> None:
    assert codes(of_frame("/pose", "map"), of_frame("/goal", "odom")) == ["two-versions"]
    assert codes(of_frame("/pose", "map"), of_frame("/goal", "map")) == []
    plans = [f"{{rooms: {{k: '{x} 0, 5 4', hysteresis: 0.5}}}}" for x in (0, 1)]
    mine, other = of_frame("/pose", "map", plans[0]), of_frame("/goal", "map", plans[1])
    assert codes(mine, other) == ["two-versions"]
    assert codes(mine, other.replace("1 0, 5 4", "0 0, 5 4")) == []
