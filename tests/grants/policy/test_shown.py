"""What a policy lets a node see, in words, whichever rules it comes from."""

from grants.filters.layout import Layout
from grants.model import Right
from grants.policy.decision import Decider, Verdict
from grants.policy.model import Policy
from grants.policy.privacy import level_lines, levels_json, shown
from grants.vocabulary.assess import Seen
from grants.vocabulary.contents import DataWord
from tests.grants.policy.policies import HEADER, node, policy
from tests.grants.vocabulary.layouts import layout_of

P, M = DataWord.POSITION, DataWord.MOVEMENT
TEXT = f"""{HEADER}types: {{/pose: geometry_msgs/PoseStamped, /cmd_vel: geometry_msgs/Twist}}
rules:
  - {{id: a, who: /heating, allow: {{subscribe: [/pose, /elsewhere]}}}}
  - {{id: b, who: /heating, allow: {{subscribe: /pose}}, see: {{position: room}}}}
  - {{id: c, who: /doctor, allow: {{subscribe: /pose}}, filter: {{use: coarse-position}}}}
  - {{id: d, who: /doctor, allow: {{subscribe: /cmd_vel}}}}
"""
POLICY = policy(TEXT)


def layout(name: str) -> Layout:
    return layout_of(name)


def verdict(name: str, topic: str, of: Policy = POLICY) -> Verdict:
    return Decider(of).decide(node(name), Right.SUBSCRIBE, topic)


def seen(name: str, topic: str) -> dict[DataWord, Seen]:
    return shown(POLICY, verdict(name, topic), layout)


def test_all_rules_hold_together() -> None:
    found = seen("/heating", "/pose")
    assert {word: one.level for word, one in found.items()} == {P: "room", M: "rough"}
    assert level_lines(found) == [
        "sees where it is: the room (no finer than 4 m, one message at the start of each 30 s)",
        "sees how it moves: only by where it is",
    ]
    assert levels_json(found) == {"position": "room", "movement": "rough"}


def test_nothing_is_said_of_what_is_not_allowed_or_not_known() -> None:
    assert seen("/nobody", "/pose") == {}
    assert seen("/heating", "/elsewhere") == {}


def test_a_preset_is_said_by_its_size_or_level() -> None:
    position = seen("/doctor", "/pose")[P]
    assert position.is_no_finer_than(2)
    assert position.level == "room"


def test_a_position_by_a_velocity_can_be_asked_for() -> None:
    of = verdict("/doctor", "/cmd_vel")
    assert P not in shown(POLICY, of, layout)
    assert not shown(POLICY, of, layout, [P])[P].is_no_finer_than(0.01)


def test_the_vocabulary_of_the_policy_counts() -> None:
    own = policy(
        f"{HEADER}types: {{/door: std_msgs/Bool}}\nvocabulary: {{/door: {{data: home}}}}\n"
        "rules: [{id: a, who: /x, allow: {subscribe: /door}, see: {home: rough}}]\n"
    )
    found = shown(own, verdict("/x", "/door", own), layout)
    assert levels_json(found) == {"home": "no"}
