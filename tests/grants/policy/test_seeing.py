"""`see` in a rule: levels of words, as the filters of its topics."""

import pytest

from grants.model import Right
from grants.policy.model import Policy
from tests.grants.policy.policies import HEADER, decide, mistakes, node, policy

HEAD = f"""{HEADER}types:
  /pose: geometry_msgs/PoseStamped
  /odom: nav_msgs/Odometry
  /camera: sensor_msgs/Image
  /door: std_msgs/Bool
  /status: diagnostic_msgs/DiagnosticStatus
"""


def text(see: str, topics: str = "/pose", more: str = "", head: str = HEAD) -> str:
    allow = f"allow: {{subscribe: [{topics}]}}"
    return f"{head}rules:\n  - {{id: a, who: /heating, {allow}, see: {see}{more}}}\n"


def lines(found: Policy, topic: str) -> list[str]:
    verdict = decide(found, node("/heating"), Right.SUBSCRIBE, topic)
    assert verdict
    rate = [] if verdict.rate is None else [f"1 in {1 / verdict.rate:.0f} s"]
    slots = [f"slot of {item.slot} s" for item in verdict.restrictions if item.slot is not None]
    return [str(rule) for item in verdict.restrictions for rule in item.filters] + slots + rate


def only(found: str) -> tuple[str, str]:
    [one] = mistakes(found)
    return one.message, one.hint


def test_a_level_becomes_a_filter_and_a_rate() -> None:
    assert lines(policy(text("{position: room}")), "/pose") == [
        "header.seq: clear",
        "header.stamp: clear",
        "pose.orientation: clear",
        "pose.position: round hysteresis 2.0 step 4.0",
        "slot of 30 s",
    ]


def test_of_all_topics_each_gets_what_concerns_it() -> None:
    found = policy(text("{position: room, image: no}", "/pose, /camera"))
    assert "pose.position: round hysteresis 2.0 step 4.0" in lines(found, "/pose")
    assert lines(found, "/camera") == ["data: zero", "header.seq: clear", "header.stamp: clear", "1 in 1 s"]


def test_by_topic() -> None:
    found = policy(text("{/camera: {image: blurred}}", "/pose, /camera"))
    assert lines(found, "/pose") == []
    assert "data: pixelate across 16 block 32 levels 8" in lines(found, "/camera")


def test_own_names_can_be_seen_at_a_level_too() -> None:
    """`~/pose` in the list of topics and in quotes `{node}/pose` in `see` are the same."""
    head = f"{HEADER}types: {{~/pose: geometry_msgs/PoseStamped, ~/door: std_msgs/Bool}}\n"
    head += "vocabulary: {~/door: {data: home}}\n"
    see = '{"{node}/pose": {position: room}, ~/door: {home: no}}'
    found = policy(text(see, "~/pose, ~/door", head=head))
    assert "pose.position: round hysteresis 2.0 step 4.0" in lines(found, "/heating/pose")
    assert lines(found, "/heating/door")[0] == "data: clear"


ROOMS = 'rooms: {kitchen: "0 0, 4 3", hall: "4 0, 9 3"}\n'


def test_rooms_of_the_policy_take_the_place_of_cells() -> None:
    found = policy(text("{position: room}", "/pose, /odom", head=HEAD + ROOMS))
    said = "rooms hall 4 0, 9 3 hysteresis 0.5 kitchen 0 0, 4 3"
    assert f"pose.position: {said}" in lines(found, "/pose")
    assert f"pose.pose.position: {said}" in lines(found, "/odom")
    assert "twist: clear" in lines(found, "/odom")


def test_rooms_and_the_area_do_not_nest() -> None:
    said = text("{position: area}", head=HEAD + ROOMS)
    assert only(said) == (
        "/pose: pose.position: where the policy has rooms, a position has no area",
        "room, or no",
    )
    wrong = f"{HEAD}rooms: {{a: '0'}}\nrules: []\n"
    assert "a" in only(wrong)[0]


def test_exact_adds_nothing() -> None:
    assert lines(policy(text("{position: exact}")), "/pose") == []


def test_a_filter_beside_it_holds_too() -> None:
    found = policy(text("{position: room}", more=", filter: {header.frame_id: {clear: true}}"))
    assert "header.frame_id: clear" in lines(found, "/pose")
    found = policy(text("{identity: no}", more=", filter: {use: coarse-position}"))
    assert {"header.frame_id: clear", "pose.orientation: clear"} <= set(lines(found, "/pose"))


def test_a_rate_beside_a_slot_applies_too() -> None:
    slow = policy(text("{position: room}", more=", limit: {rate: 0.01}"))
    assert lines(slow, "/pose")[-1] == "1 in 100 s"


def test_a_condition_beside_it_holds_too() -> None:
    found = policy(text("{position: room}", more=", when: 'now.getHours() > 6'"))
    [restriction] = decide(found, node("/heating"), Right.SUBSCRIBE, "/pose").restrictions
    assert restriction.type == "geometry_msgs/PoseStamped"
    assert restriction.conditions == ("now.getHours() > 6",)


def test_what_is_published_is_not_touched() -> None:
    both = "{subscribe: [/pose], publish: [/pose]}"
    said = f"{HEAD}rules:\n  - {{id: a, who: /heating, allow: {both}, see: {{position: no}}}}\n"
    assert decide(policy(said), node("/heating"), Right.PUBLISH, "/pose").restrictions == ()


def test_two_rules_hold_together() -> None:
    one = text("{position: room}")
    two = "  - {id: b, who: '*', allow: {subscribe: [/pose]}, see: {position: area}}\n"
    assert lines(policy(one + two), "/pose")[-2:] == ["slot of 300 s", "slot of 30 s"]


def test_a_policy_says_what_a_bare_value_is() -> None:
    said = HEAD + "vocabulary: {/door: {data: home}}\n"
    assert lines(policy(text("{home: no}", "/door", head=said)), "/door")[0] == "data: clear"
    assert policy(said + "rules: []\n").vocabulary.topics.keys() == {"/door"}


@pytest.mark.parametrize(
    ("found", "message", "hint"),
    [
        (text("{positon: room}"), "unknown word 'positon' in see", "did you mean 'position'?"),
        (text("{position: romm}"), "unknown level of position: 'romm'", "'room'"),
        (text("{image: area}"), "unknown level of image: 'area'", ""),
        (text("{presence: no}"), "presence: a message that arrives tells it", "minute or hour"),
        (text("[room]"), "see of rule a must be a mapping", ""),
        (text("{}"), "rule a: nothing to see", "remove see"),
        (text("{/odom: {position: no}}"), "rule a has no subscribe right on '/odom'", ""),
        (text("{/pose: no}"), "see of /pose must be a mapping", ""),
        (
            text("{home: no}", "/door"),
            "/door: data of std_msgs/Bool is a bare value",
            "say it: vocabulary: {/door: {data: home}}",
        ),
        (text("{position: no}", "/elsewhere"), "the message type of /elsewhere is unknown", "add"),
        (
            text("{position: room, movement: exact}", "/odom"),
            "/odom: movement cannot be exact beside position: room",
            "leave out movement: exact",
        ),
        (
            text("{position: room}", more=", filter: {pose: {clear: true}}"),
            "/pose: pose is inside a field that has a filter",
            "keep one",
        ),
        (
            text("{position: room}", more=", filter: {use: coarse-position}"),
            "/pose: header.seq is inside a field",
            "keep one",
        ),
    ],
)
def test_mistakes_are_named_with_what_to_do(found: str, message: str, hint: str) -> None:
    said, remedy = only(found)
    assert said.startswith(message)
    assert hint in remedy


def test_a_denial_has_no_levels() -> None:
    said = f"{HEAD}rules:\n  - {{id: a, who: /x, deny: {{subscribe: [/pose]}}, see: {{image: no}}}}"
    assert only(said)[0] == "rule a: a deny rule cannot have 'see'"


def test_the_schema_knows_it() -> None:
    from tests.grants.policy.test_schema import check

    assert check(text("{position: room}")) == []
    assert check(text("{/pose: {position: room}}")) == []
    assert check(text("{position: kitchen}")) != []
    assert check(HEAD + "vocabulary: {/door: {data: home}, a_b/C: {d.e: name}}\nrules: []\n") == []
    assert check(text("{position: room}", head=HEAD + ROOMS)) == []
    assert check(text('{"~/pose": {position: room}}')) == []
    assert check(HEAD + "vocabulary: {~/door: {data: home}}\nrules: []\n") == []
    assert check(HEAD + "vocabulary: {/door: {data: bare}}\nrules: []\n") != []


@pytest.mark.parametrize("turn", [1, -1])
def test_a_level_holds_on_each_topic_of_a_pattern(turn: int) -> None:
    """The pattern was shown by what is said of it, also the topic that is said to be another."""
    said = ["/a/x: {data: coordinate}", '"/*/x": {data: temperature}'][::turn]
    head = f"""{HEADER}types: {{"/*/x": std_msgs/Float64, /a/x: std_msgs/Float64}}
vocabulary: {{{", ".join(said)}}}
"""
    assert lines(policy(text("{position: no}", "/a/x", head=head)), "/a/x")[0] == "data: clear"
    assert lines(policy(text("{position: exact}", '"/*/x"', head=head)), "/a/x") == []
    message, hint = only(text("{position: no}", '"/*/x"', head=head))
    assert message == "/*/x: the vocabulary says something else of data on /a/x"
    assert hint == "name the topics one by one, or say the same of both"
