"""What a receiver would see: the real guard over messages."""

import pytest

from grants.errors import GrantError
from grants.model import Restriction, filter_rules
from rossec.console import samples
from rossec.console.samples import Recorded, as_mapping, see, try_see
from rossec.errors import MessageError
from rossec.participant.message_types import message_type
from tests.support.consolehome import COARSE, POSE


def recorded(kind: str = POSE) -> Recorded:
    found = samples.recorded("/robot/pose", kind)
    assert found is not None
    return found


def test_the_filter_of_the_grant_is_applied() -> None:
    seen = see(recorded(), "/heating", [COARSE])
    assert (seen.sent, len(seen.samples), seen.is_made_up) == (240, 240, True)
    pose = seen.samples[0].fields["pose"]
    assert pose["position"]["x"] % 2 == 0
    assert pose["orientation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0}
    assert seen.samples[0].fields["header"]["frame_id"] == ""
    whole = see(recorded(), "/doctor", [])
    assert whole.samples[0].fields["header"]["frame_id"] == "map"


def test_the_conditions_hold_for_real_messages_and_are_left_out_of_made_up_ones() -> None:
    never = Restriction(POSE, ('msg.header.frame_id == "elsewhere"',))
    assert len(see(recorded(), "/a", [never]).samples) == 240
    real = recorded()._replace(is_made_up=False)
    assert see(real, "/a", [never]).samples == ()
    both = Restriction(POSE, never.conditions, COARSE.filters)
    assert see(recorded(), "/a", [both]).samples[0].fields["header"]["frame_id"] == ""


def test_a_pseudonym_needs_no_key_of_the_publisher() -> None:
    hashed = Restriction(POSE, (), filter_rules({"header.frame_id": {"hash": {"key": "k", "length": 8}}}))
    shown = see(recorded(), "/a", [hashed]).samples[0].fields["header"]["frame_id"]
    assert len(shown) == 8
    assert shown != "map"


def test_what_does_not_fit_is_refused_as_by_a_guard() -> None:
    with pytest.raises(GrantError):
        see(recorded("std_msgs/String"), "/a", [COARSE])
    assert try_see(recorded("std_msgs/String"), "/a", [COARSE]) is None
    unknown = recorded()._replace(type="a/B")
    with pytest.raises(MessageError):
        see(unknown, "/a", [])
    assert try_see(unknown, "/a", []) is None


def test_a_message_as_a_mapping_has_messages_inside_as_mappings() -> None:
    kind = message_type("diagnostic_msgs/DiagnosticArray")
    message = kind.create()
    message.status = [message_type("diagnostic_msgs/DiagnosticStatus").create()]
    found = as_mapping(message)
    assert found["status"][0]["values"] == []
    assert found["header"]["stamp"] == {"sec": 0, "nanosec": 0}
