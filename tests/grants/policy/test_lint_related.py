"""What else tells what is hidden: each row, what is no relative, services, the graph, slots."""

import pytest

from grants.policy.lint_topics import RELATED
from tests.grants.policy.lint_cases import codes, findings, messages, text_of
from tests.grants.policy.lint_leaks import COARSE, HASHED, PERSONAL, SECOND, also, filtered
from tests.grants.policy.lint_leaks_related import KEPT

HIDDEN = filtered("/cmd_vel", "linear: {clear: true}, angular: {clear: true}", SECOND)
NAMELESS = filtered("/diagnostics", "status[*].name: {clear: true}, status[*].hardware_id: {clear: true}")
AIR = "header: {clear: true}, variance: {clear: true}, temperature: {clear: true}"


def test_rows_are_a_table() -> None:
    assert len({row.own for row in RELATED}) == len(RELATED)
    assert all(row.own[0] in row.told_by for row in RELATED)


def test_a_movement_is_told_by_a_place_and_by_joints() -> None:
    assert messages(HIDDEN, also("/pose, /joints, /map, /words")) == [
        "rule a: /x sees /cmd_vel coarsely, but /joints exactly",
        "rule a: /x sees /cmd_vel coarsely, but /pose exactly",
    ]


def test_what_hides_a_part_hides_no_movement() -> None:
    """A turn rate without a speed: the movement is seen anyway."""
    assert codes(filtered("/cmd_vel", "angular: {clear: true}"), also("/pose")) == []


def test_a_topic_that_is_filtered_too_tells_nothing() -> None:
    still = filtered("/odom", "twist: {clear: true}, pose: {clear: true}", SECOND)
    assert codes(HIDDEN, still.replace("id: a", "id: b")) == []


def test_several_kinds_of_one_topic_are_closed_together() -> None:
    types = {"/air": "sensor_msgs/Temperature", "/attic": "sensor_msgs/Temperature"}
    text = text_of(filtered("/air", AIR, SECOND), also("/attic"), types=types)
    [finding] = findings(text)
    assert finding.hint == ("filter /attic as well: temperature: {clear: true}, variance: {clear: true}")


def test_states_of_different_things_do_not_tell_each_other() -> None:
    types = {"/battery": "sensor_msgs/BatteryState", "/goals": "actionlib_msgs/GoalStatusArray"}
    hidden = "id: a, who: /x, allow: {subscribe: [/battery]}, see: {home: rough}"
    assert codes(hidden, also("/goals"), types=types) == []


def test_names_of_joints_are_not_those_of_devices() -> None:
    assert codes(NAMELESS, also("/joints")) == []
    types = {"/robot/info": "sensor_msgs/CameraInfo"}
    joints = filtered("/joints", "name: {clear: true}")
    assert codes(joints, also("/diagnostics")) == []
    for named in ("/robot/info", "'/robot/**'"):
        assert codes(NAMELESS, also(named), types=types) == ["exact-relative"]


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        ("/pose", ["presence-open"]),
        ("/bed/pose", ["presence-open"]),
        ("/clock", []),
        ("/x/orders", []),
        ("'/lamp/*'", []),
    ],
)
def test_slots_are_undone_by_what_comes_as_it_is_sent(other: str, expected: list[str]) -> None:
    types = {"/bed/pose": "geometry_msgs/PoseStamped", "/x/orders": "std_msgs/String"}
    given = {topic: kind for topic, kind in types.items() if topic == other}
    assert codes(KEPT, also(other), types=given) == expected


def test_slots_of_another_folder() -> None:
    kept = "id: a, who: /x, allow: {subscribe: [/bed/words]}, filter: {use: presence-only}"
    for other, expected in (("/lamp/words", []), ("/bed/a/words", ["presence-open"])):
        types = dict.fromkeys(("/bed/words", other), "std_msgs/String")
        assert codes(kept, also(other), types=types) == expected


@pytest.mark.parametrize("names", ["/a/make_plan", "/static_map", "/move_base/*", "/**"])
def test_services_that_tell_a_pose(names: str) -> None:
    call = f"id: b, who: /x, allow: {{call: ['{names}']}}"
    assert "service-tells" in codes(COARSE, call)
    assert "service-tells" not in codes(also("/pose"), call.replace("id: b", "id: c"))
    denied = "id: no, who: '*', deny: {call: ['/**']}"
    assert "service-tells" not in codes(COARSE, call, denied)


def test_its_own_services_and_others_tell_nothing() -> None:
    own = "id: b, who: /x, allow: {call: [~/get_pose, /lamp/set, '/a/*/make_plan']}"
    assert codes(COARSE, own) == []


def test_the_graph_tells_what_is_hidden() -> None:
    graph = "id: b, who: /x, allow: {graph: ['/*']}"
    for hidden in (COARSE, KEPT, NAMELESS):
        assert codes(hidden, graph) == ["graph-tells"]
    assert codes(also("/pose"), graph.replace("id: b", "id: c")) == []
    assert codes(COARSE, graph.replace("/*", "/rooms/*")) == []


def test_pseudonyms_for_all_of_a_pattern() -> None:
    everybody = filtered("/diagnostics", HASHED).replace("who: /x", "who: '/phones/*'")
    assert codes(everybody) == ["shared-pseudonym"]
    assert codes(everybody.replace("{hash: k}", PERSONAL)) == []
