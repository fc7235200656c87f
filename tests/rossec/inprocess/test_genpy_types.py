"""Message types as the classes of a process have them."""

import pytest
from geometry_msgs.msg import Twist
from rospy import AnyMsg
from std_msgs.msg import String

from rossec.channel.records import ChannelLimits
from rossec.inprocess.genpy_types import described, installed, longest, room
from rossec.net.bounds import BATCH_LIMIT
from rossec.participant.message_types import message_type
from rossec.ros.header import HEADER_LIMIT

pytestmark = pytest.mark.ros


def test_a_class_says_what_it_reads() -> None:
    own, known = described(Twist), message_type("geometry_msgs/Twist")
    assert (own.name, own.md5sum) == (known.name, known.md5sum)
    assert own.layout.digest == known.layout.digest
    assert described(AnyMsg).name == "*"


def test_how_long_messages_may_be() -> None:
    assert longest(Twist) == HEADER_LIMIT
    assert room(Twist) == HEADER_LIMIT + BATCH_LIMIT
    for kind in (AnyMsg, String):
        assert longest(kind) == ChannelLimits.unit
        assert room(kind) > ChannelLimits.unit


def test_what_is_installed_is_known() -> None:
    assert installed("geometry_msgs/Twist") == described(Twist)
    for name in ("geometry_msgs/Such", "no_such_package/Twist", "*", "", "Twist"):
        assert installed(name) is None
