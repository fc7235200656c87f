"""Message types as the genpy classes of a process define them."""

import pytest
from geometry_msgs.msg import Twist
from rospy import AnyMsg
from std_msgs.msg import String

from rossec.inprocess.connections import definition_of, installed_definition, max_message_size, max_unit_size
from rossec.net.limits import BATCH_LIMIT
from rossec.participant.message_types import message_type
from rossec.ros.tcpros import HEADER_LIMIT, MESSAGE_LIMIT

pytestmark = pytest.mark.ros


def test_a_class_defines_name_checksum_and_layout() -> None:
    own, known = definition_of(Twist), message_type("geometry_msgs/Twist")
    assert (own.name, own.md5sum) == (known.name, known.md5sum)
    assert own.layout.digest == known.layout.digest
    assert definition_of(AnyMsg).name == "*"


def test_sizes_follow_the_type() -> None:
    assert max_message_size(Twist) == HEADER_LIMIT
    assert max_unit_size(Twist) == HEADER_LIMIT + BATCH_LIMIT
    for kind in (AnyMsg, String):
        assert max_message_size(kind) == MESSAGE_LIMIT
        assert max_unit_size(kind) > MESSAGE_LIMIT


def test_only_installed_types_have_a_definition() -> None:
    assert installed_definition("geometry_msgs/Twist") == definition_of(Twist)
    for name in ("geometry_msgs/Such", "no_such_package/Twist", "*", "", "Twist"):
        assert installed_definition(name) is None
