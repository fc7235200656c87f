"""Messages on the command line: filled from YAML, shown as rostopic shows them."""

from typing import Any

import numpy as np
import pytest

from rossec.cli.shared import message_text
from rossec.errors import ConfigurationError
from rossec.participant.message_types import message_type
from tests.support.commands import Shell, refused

STRING = "std_msgs/String"


def filled(type_name: str, content: object) -> Any:
    message = message_type(type_name).create()
    message_text.fill(message, content)
    return message


def test_messages_are_written_as_in_rostopic() -> None:
    message = filled("geometry_msgs/PoseStamped", {"pose": {"position": {"x": 1}}})
    assert message.pose.position.x == 1.0
    assert isinstance(message.pose.position.x, float)
    scan = filled("sensor_msgs/LaserScan", {"ranges": [1, 2.5], "header": {"frame_id": "laser"}})
    assert scan.ranges.dtype == np.float32
    assert "header:\n  seq: 0\n  stamp:\n    sec: 0" in message_text.render(scan)


def test_text_of_a_peer_stays_on_its_line() -> None:
    assert message_text.render(filled(STRING, {"data": "a\n---\ndata: \x1b[2J\u202eb"})) == (
        "data: a\\n---\\ndata: \\u001b[2J\\u202eb"
    )


def test_arrays_are_shown_as_in_rostopic() -> None:
    scan = filled("sensor_msgs/LaserScan", {"ranges": [1, 2.5] * 1000})
    assert "\nranges: [1.0, 2.5, 1.0, 2.5," in message_text.render(scan)
    assert "\nintensities: []" in message_text.render(scan)
    image = filled("sensor_msgs/Image", {"data": [1, 255]})
    assert message_text.render(image).endswith("\ndata: [1, 255]")
    joints = message_type("sensor_msgs/JointState").create()
    joints.name = ["left", "a\n', '"]
    assert "\nname: ['left', 'a\\n', '']\n" in message_text.render(joints)
    path = message_type("nav_msgs/Path").create()
    assert message_text.render(path).endswith("\nposes: []")
    path.poses = [filled("geometry_msgs/PoseStamped", {"header": {"frame_id": "map"}})] * 2
    assert message_text.render(path).count("\n  -\n    header:\n      seq: 0\n") == 2


@pytest.mark.parametrize(
    ("content", "error"),
    [
        ("text", "a message is a mapping"),
        ({"poze": 1}, "no field 'poze' in geometry_msgs/PoseStamped"),
        ({"pose": 7}, "a message is a mapping"),
        ({"header": {"seq": "many"}}, "seq"),
        ({"header": {"frame_id": 5}}, "frame_id"),
    ],
)
def test_a_message_that_is_none(content: object, error: str) -> None:
    with pytest.raises(ConfigurationError, match=error):
        filled("geometry_msgs/PoseStamped", content)


def test_invalid_yaml_is_refused(empty: Shell) -> None:
    refused(
        empty("topic", "pub", "/chatter", STRING, "{data: [", "--as", "/talker"), "cannot parse"
    )
