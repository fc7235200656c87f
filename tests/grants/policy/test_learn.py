"""From a graph or a denial log to rules, without learning what is decided already."""

import json

import pytest

from grants.errors import PolicyRefused
from grants.model import Right
from grants.policy import learn as module
from grants.policy.decision import Decider
from grants.policy.learn import Observation, from_graph, from_log, learn, learnable, log_line, needs_basics
from grants.policy.model import Subject
from tests.grants.policy.policies import SMALL, policy

STATE = [
    [["/cmd_vel", ["/nav/a", "/joy"]], ["/robot/pose", ["/joy"]]],
    [["/camera/image", ["/joy"]]],
    [["/lift", ["/joy"]]],
]
TYPES = [["/cmd_vel", "geometry_msgs/Twist"], ["/robot/pose", "geometry_msgs/PoseStamped"]]


def test_observations_of_a_graph() -> None:
    assert from_graph(STATE, TYPES) == [
        Observation("/joy", Right.PUBLISH, "/cmd_vel", "geometry_msgs/Twist"),
        Observation("/joy", Right.PUBLISH, "/robot/pose", "geometry_msgs/PoseStamped"),
        Observation("/joy", Right.SUBSCRIBE, "/camera/image"),
        Observation("/joy", Right.PROVIDE, "/lift"),
        Observation("/nav/a", Right.PUBLISH, "/cmd_vel", "geometry_msgs/Twist"),
    ]


@pytest.mark.parametrize(
    "state",
    [
        5,
        [],
        [[], []],
        [[], [], 5],
        [[["/a"]], [], []],
        [[["/a", 5]], [], []],
        [[["/a", [5]]], [], []],
        [[["a b", ["/n"]]], [], []],
    ],
)
def test_a_malformed_graph_is_refused(state: object) -> None:
    with pytest.raises(PolicyRefused, match="not the state of a ROS graph"):
        from_graph(state)


def test_the_denial_log_round_trips() -> None:
    lines = [
        log_line(5, "/joy", Right.CALL, "/lift"),
        "\n",
        log_line(6, "/joy", Right.PARAM_GET, "/speed", "x/Y"),
        log_line(7, "/joy", Right.CALL, "/lift"),
    ]
    assert from_log(lines) == [
        Observation("/joy", Right.CALL, "/lift"),
        Observation("/joy", Right.PARAM_GET, "/speed", "x/Y"),
    ]


@pytest.mark.parametrize(
    "line",
    [
        "{",
        "5",
        "[]",
        "{}",
        '{"node": "/a", "right": "publish"}',
        '{"node": "/a", "right": "publish", "name": "/b", "more": 1}',
        '{"node": "/a", "right": "publsh", "name": "/b"}',
        '{"node": "/a", "right": ["publish"], "name": "/b"}',
        '{"node": "a", "right": "publish", "name": "/b"}',
        '{"node": "/a", "right": "publish", "name": 5}',
        json.dumps({"node": "/a", "right": "publish", "name": "/b", "type": "x" * 5000}),
        "[" * 4000,
    ],
)
def test_an_invalid_line_is_named(line: str) -> None:
    with pytest.raises(PolicyRefused, match="line 2 of the denial log is invalid"):
        from_log([log_line(1, "/a", Right.CALL, "/b"), line])


def test_a_log_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_OBSERVATIONS", 2)
    with pytest.raises(PolicyRefused, match="more than 2"):
        from_log(log_line(1, f"/n{n}", Right.CALL, "/b") for n in range(5))


def test_only_what_no_rule_decides_is_learned() -> None:
    text, rules = learn(SMALL, Decider(policy()), from_graph(STATE, TYPES), "2026-11-21")
    (rule,) = rules  # /nav/a may publish already, the camera is denied
    assert (rule.id, rule.who, rule.why) == ("learned-joy", "/joy", "seen running 2026-11-21; review me")
    assert rule.rights == {"publish": ["/cmd_vel", "/robot/pose"], "provide": ["/lift"]}
    read = policy(text)
    assert read.rules[-1].id == "learned-joy"
    assert read.types["/cmd_vel"] == "geometry_msgs/Twist"
    assert learn(text, Decider(read), from_graph(STATE, TYPES), "later") == (text, [])


def test_rights_of_a_pinned_key_are_not_learned_for_the_name() -> None:
    seen = [Observation("/heating", Right.SUBSCRIBE, "/robot/pose")]
    assert learn(SMALL, Decider(policy()), seen, "today")[1] == []


def test_nothing_is_learned_of_other_masters_names() -> None:
    decider = Decider(policy(SMALL))
    observed = [
        Observation("/remote/hospital/robot", Right.SUBSCRIBE, "/pose"),
        Observation("/viewer", Right.SUBSCRIBE, "/remote/hospital/pose"),
    ]
    assert learn(SMALL, decider, observed, "2026-11-22") == (SMALL, [])


@pytest.mark.parametrize(
    ("node", "name", "learned"),
    [
        ("/robot1", "/robot1/pose", ("/robot1", "{node}/pose")),
        ("/robot1", "/robot2/pose", ("/robot1", "/robot2/pose")),
        ("/rviz", "/rviz_1795466501944712825/load", ("/rviz", "{node}/load")),
        ("/rviz_1795466501944712825", "/goal", ("/rviz", "/goal")),
        ("/rostopic_16936_1795466494397", "/scan", ("/rostopic", "/scan")),
        ("/rostopic_16936_1795466494397", "/rostopic_16936_1795466494397/x", ("/rostopic", "{node}/x")),
        ("/robot_12", "/camera_7/image", ("/robot_12", "/camera_7/image")),
    ],
)
def test_names_are_learned_as_rules_say_them(node: str, name: str, learned: tuple[str, str]) -> None:
    found = learnable(Observation(node, Right.PROVIDE, name, "a/B"))
    assert found == Observation(learned[0], Right.PROVIDE, learned[1], "a/B")


@pytest.mark.parametrize(
    ("node", "right", "name"),
    [
        ("/a", Right.CALL, "/rviz_1795466501944712825/load"),
        ("/a", Right.PUBLISH, "/rosout"),
        ("/a", Right.PROVIDE, "/a/get_loggers"),
        ("/rviz", Right.PROVIDE, "/rviz_1795466501944712825/get_loggers"),
        ("/a", Right.SUBSCRIBE, "/remote/hospital/pose"),
        ("/remote/hospital/a", Right.SUBSCRIBE, "/pose"),
    ],
)
def test_nothing_is_learned_of_what_no_rule_should_say(node: str, right: Right, name: str) -> None:
    assert learnable(Observation(node, right, name)) is None


def test_basics_that_were_used_are_told() -> None:
    assert needs_basics([Observation("/a", Right.PARAM_GET, "/use_sim_time")])
    assert not needs_basics([Observation("/a", Right.PARAM_GET, "/speed")])


def test_what_is_learned_is_a_policy_that_gives_it() -> None:
    name = "/rviz_1795466501944712825/load"
    seen = [Observation("/rviz", Right.PROVIDE, name, "std_srvs/Empty")]
    text, _ = learn(SMALL, Decider(policy(SMALL)), seen, "2026-11-20")
    read = policy(text.replace("std_srvs/Empty", "std_msgs/String"))
    assert "1795466501944712825" not in text
    verdict = Decider(read).decide(Subject("/rviz", bytes(32), tail=True), Right.PROVIDE, "{node}/load")
    assert verdict
    assert learn(text, Decider(read), seen, "2026-11-21") == (text, [])


def test_own_topics_that_differ_in_type_are_learned_by_their_names() -> None:
    """One type was written for all of them, and a level on the other would fit no message."""
    text = "rossec: 1\nrobot: r\nrules: []\n"
    pose, odom = "geometry_msgs/PoseStamped", "nav_msgs/Odometry"
    seen = [
        Observation("/a", Right.PUBLISH, "/a/at", pose),
        Observation("/b", Right.PUBLISH, "/b/at", odom),
        Observation("/a", Right.PUBLISH, "/a/way", odom),
        Observation("/b", Right.PUBLISH, "/b/way", odom),
    ]
    learned, _ = learn(text, Decider(policy(text)), seen, "2026-11-20")
    assert policy(learned).types == {"/a/at": pose, "/b/at": odom, "{node}/way": odom}
    again = "rossec: 1\nrobot: r\ntypes: {~/at: nav_msgs/Odometry}\nrules: []\n"
    learned, _ = learn(again, Decider(policy(again)), seen[:1], "2026-11-20")
    assert policy(learned).type_of("/a/at") == pose


@pytest.mark.parametrize("length", [60, 71, 72, 80, 200])
def test_nodes_whose_names_begin_alike_get_rules_of_their_own(length: int) -> None:
    """Ids are cut: a right of one node was in the rule of the other."""
    first, second = (f"/{'n' * length}/{end}" for end in ("first", "second"))
    seen = [Observation(first, Right.CALL, "/a"), Observation(second, Right.CALL, "/b")]
    text = "rossec: 1\nrobot: r\nrules: []\n"
    for one in (seen[:1], seen[1:], seen):
        text, _ = learn(text, Decider(policy(text)), one, "2026-11-27")
    read = policy(text)
    assert [(rule.who[0].node, rule.clauses[0].pattern) for rule in read.rules] == [
        (first, "/a"),
        (second, "/b"),
    ]


def test_a_learned_rule_that_was_changed_is_not_extended() -> None:
    """Its id is kept by whoever reviewed it, and is for others by now."""
    for changed in (
        'who: "*", allow: {call: [/x]}',
        "who: /a, deny: {call: [/x]}",
        "who: /a, allow: {call: [/x]}, lifetime: 1h",
    ):
        text = f"rossec: 1\nrobot: r\nrules:\n  - {{id: learned-a, {changed}}}\n"
        new, (rule,) = learn(text, Decider(policy(text)), [Observation("/a", Right.CALL, "/b")], "2026-11-27")
        assert rule.id == "learned-a-2"
        assert [len(each.clauses) for each in policy(new).rules] == [1, 1]
