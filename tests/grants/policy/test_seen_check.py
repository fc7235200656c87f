"""Whether words of the vocabulary are seen as tests say; fields are in `test_assertion_check`."""

import pytest

from grants.errors import PolicyRefused
from grants.model import Right
from grants.policy.assertion_check import seen_too_well
from grants.policy.assertions import Limit, SeenField
from grants.policy.decision import Decider
from rossec.authority.policyfile import layout_of
from tests.grants.policy.policies import node, policy

TEXT = """rossec: 1
robot: test
types:
  /pose: geometry_msgs/PoseStamped
  /joints: sensor_msgs/JointState
rules:
  - {id: room, who: /room, allow: {subscribe: /pose}, see: {position: room}}
  - {id: grid, who: /grid, allow: {subscribe: /pose}, filter: {pose.position: {round: 2.0}}}
  - {id: all, who: /all, allow: {subscribe: [/pose, /joints, /scan]}}
"""


def too_well(who: str, path: str, limit: Limit, topic: str = "/pose") -> str:
    read = policy(TEXT)
    verdict = Decider(read).decide(node(who), Right.SUBSCRIBE, topic)
    return seen_too_well(read, layout_of, verdict, SeenField(topic, path, limit, 1))


def test_a_level_holds_for_itself_and_for_what_is_finer() -> None:
    assert too_well("/room", "position", "room") == ""
    assert too_well("/room", "position", 2.0) == ""
    assert "position (room" in too_well("/room", "position", "area")
    assert "position (room" in too_well("/room", "position", "no")
    assert too_well("/room", "position", "exact") == "position"
    assert too_well("/all", "position", "exact") == ""


def test_every_field_that_tells_it_counts() -> None:
    """A grid beside an open orientation is no room."""
    assert too_well("/grid", "pose.position", 2.0) == ""
    assert "position (exact" in too_well("/grid", "position", "room")


@pytest.mark.parametrize(
    ("path", "limit", "message"),
    [
        ("position", "rom", "not a level of position: 'rom'"),
        ("identity", 2.0, "identity has no length"),
        ("pose", "room", "not how a field is seen: 'room'"),
        ("speed", 2.0, "no field 'speed'"),
        ("header.frame_id", 2.0, "header.frame_id is no number"),
    ],
)
def test_what_cannot_be_told_is_refused(path: str, limit: Limit, message: str) -> None:
    with pytest.raises(PolicyRefused) as error:
        too_well("/all", path, limit)
    assert message in str(error.value)


def test_a_topic_of_an_unknown_type_is_refused() -> None:
    with pytest.raises(PolicyRefused, match="the message type of /scan is unknown"):
        too_well("/all", "ranges", 1.0, "/scan")


def test_words_that_a_type_tells_only_beside_others_count_too() -> None:
    assert too_well("/all", "position", "exact", "/joints") == ""
    assert too_well("/all", "position", 0.5, "/joints").startswith("position (exact, by position")
