"""From a graph or a complain log to rules, without learning what is decided already."""

import json

import pytest

from grants.errors import PolicyRefused
from grants.model import Right
from grants.policy import learn as module
from grants.policy.decision import Decider
from grants.policy.learn import Observation, from_graph, from_log, learn, log_line
from tests.grants.policy.policies import SMALL, policy

STATE = [
    [["/cmd_vel", ["/nav/a", "/joy"]], ["/robot/pose", ["/joy"]]],
    [["/camera/image", ["/joy"]]],
    [["/lift", ["/joy"]]],
]
TYPES = [["/cmd_vel", "geometry_msgs/Twist"], ["/robot/pose", "geometry_msgs/PoseStamped"]]


def test_the_graph() -> None:
    assert from_graph(STATE, TYPES) == [
        Observation("/joy", Right.PUBLISH, "/cmd_vel", "geometry_msgs/Twist"),
        Observation("/joy", Right.PUBLISH, "/robot/pose", "geometry_msgs/PoseStamped"),
        Observation("/joy", Right.SUBSCRIBE, "/camera/image"),
        Observation("/joy", Right.PROVIDE, "/lift"),
        Observation("/nav/a", Right.PUBLISH, "/cmd_vel", "geometry_msgs/Twist"),
    ]


@pytest.mark.parametrize(
    "state", [5, [], [[], []], [[], [], 5], [[["/a"]], [], []], [[["/a", 5]], [], []],
              [[["/a", [5]]], [], []], [[["a b", ["/n"]]], [], []]]
)  # fmt: skip
def test_another_shape_is_refused(state: object) -> None:
    with pytest.raises(PolicyRefused, match="not the state of a ROS graph"):
        from_graph(state)


def test_the_complain_log_is_read_as_it_is_written() -> None:
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
        "{", "5", "[]", "{}", '{"node": "/a", "right": "publish"}',
        '{"node": "/a", "right": "publish", "name": "/b", "more": 1}',
        '{"node": "/a", "right": "publsh", "name": "/b"}',
        '{"node": "/a", "right": ["publish"], "name": "/b"}',
        '{"node": "a", "right": "publish", "name": "/b"}',
        '{"node": "/a", "right": "publish", "name": 5}',
        json.dumps({"node": "/a", "right": "publish", "name": "/b", "type": "x" * 5000}),
        "[" * 4000,
    ],
)  # fmt: skip
def test_a_line_that_is_none_is_named(line: str) -> None:
    with pytest.raises(PolicyRefused, match="line 2 of the complain log is none"):
        from_log([log_line(1, "/a", Right.CALL, "/b"), line])


def test_a_log_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_OBSERVATIONS", 2)
    with pytest.raises(PolicyRefused, match="more than 2"):
        from_log(log_line(1, f"/n{n}", Right.CALL, "/b") for n in range(5))


def test_only_what_no_rule_decides_is_learned() -> None:
    text, rules = learn(SMALL, Decider(policy()), from_graph(STATE, TYPES), "2026-11-21")
    (rule,) = rules  # /nav/a may publish already, the camera is denied
    assert (rule.id, rule.who, rule.why) == (
        "learned-joy", "/joy", "seen running 2026-11-21; review me",
    )  # fmt: skip
    assert rule.rights == {"publish": ["/cmd_vel", "/robot/pose"], "provide": ["/lift"]}
    read = policy(text)
    assert read.rules[-1].id == "learned-joy"
    assert read.types["/cmd_vel"] == "geometry_msgs/Twist"
    assert learn(text, Decider(read), from_graph(STATE, TYPES), "later") == (text, [])


def test_what_a_pinned_key_may_is_not_learned_for_the_name() -> None:
    seen = [Observation("/heating", Right.SUBSCRIBE, "/robot/pose")]
    assert learn(SMALL, Decider(policy()), seen, "today")[1] == []
