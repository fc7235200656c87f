"""Messages on the command line: filled from YAML, shown as rostopic shows them."""

from typing import Any

import numpy as np
import pytest

from rossec import clock
from rossec.cli.shared import messages
from rossec.cli.shared.messages import fill, flat, parse_arguments, parse_message, plain, render
from rossec.errors import ConfigurationError
from rossec.participant.message_types import message_type, register_type
from tests.support.commands import Shell, refused

STRING = "std_msgs/String"


def filled(type_name: str, content: object) -> Any:
    message = message_type(type_name).create()
    messages.fill(message, content)
    return message


def test_messages_are_written_as_in_rostopic() -> None:
    message = filled("geometry_msgs/PoseStamped", {"pose": {"position": {"x": 1}}})
    assert message.pose.position.x == 1.0
    assert isinstance(message.pose.position.x, float)
    scan = filled("sensor_msgs/LaserScan", {"ranges": [1, 2.5], "header": {"frame_id": "laser"}})
    assert scan.ranges.dtype == np.float32


def test_a_time_has_many_forms() -> None:
    now = 5_000_000_007
    for content in ({"secs": 5, "nsecs": 7}, {"sec": 5, "nanosec": 7}, [5, 7], now, "now"):
        message = message_type("std_msgs/Time").create()
        messages.fill(message, {"data": content}, now)
        assert (message.data.sec, message.data.nanosec) == (5, 7), content
    header = message_type("geometry_msgs/PoseStamped").create()
    messages.fill(header, {"header": "auto"}, now)
    assert (header.header.stamp.sec, header.header.seq) == (5, 0)


def test_lists_stand_for_all_fields_in_order() -> None:
    twist = filled("geometry_msgs/Twist", [[1, 0, 0], [0, 0, 2.5]])
    assert (twist.linear.x, twist.angular.z) == (1.0, 2.5)
    assert filled(STRING, ["hello"]).data == "hello"


def test_lists_of_messages_and_texts() -> None:
    path = filled("nav_msgs/Path", {"poses": [{"pose": {"position": {"x": 1}}}, {}]})
    assert [item.pose.position.x for item in path.poses] == [1.0, 0.0]
    assert filled("sensor_msgs/JointState", {"name": ["a", None]}).name == ["a", ""]


def test_values_that_yaml_writes_otherwise() -> None:
    assert filled(STRING, {"data": None}).data == ""
    assert filled("std_msgs/Float64", {"data": "-inf"}).data == float("-inf")
    assert filled("std_msgs/Float32MultiArray", {"data": ["inf", 1]}).data[0] == np.inf
    assert bytes(filled("std_msgs/UInt8MultiArray", {"data": b"ab"}).data) == b"ab"


def test_a_stamp_is_of_this_hosts_clock() -> None:
    before = clock.now()
    assert before <= messages.stamp_now() // 1_000_000_000 <= before + 60


def test_now_is_found_anywhere() -> None:
    assert messages.mentions_now({"header": {"stamp": "now"}})
    assert messages.mentions_now([[{"header": "auto"}]])
    assert not messages.mentions_now({"data": "later", "more": [1]})


def test_arguments_are_one_mapping_or_the_fields_in_order() -> None:
    assert messages.parse_arguments(["{data: 1}"]) == {"data": 1}
    assert messages.parse_arguments(["[1, 0]", "[2]"]) == [[1, 0], [2]]
    assert messages.parse_arguments(["hello"]) == ["hello"]
    assert messages.parse_arguments([]) == {}


def test_documents_are_separated_as_echo_separates_them() -> None:
    text = "data: 1\n---\ndata: 2\n---\n"
    assert messages.parse_documents(text) == [{"data": 1}, {"data": 2}]
    assert messages.parse_documents("---\n") == []


@pytest.mark.parametrize(
    ("type_name", "content", "error", "hint"),
    [
        (STRING, {"data": 5}, "data is text, not a whole number", "put text that looks like"),
        (STRING, ["a", "b"], "2 values for 1 field$", "give all of data in this order"),
        ("nav_msgs/Path", {"poses": {}}, "poses is a list, not a mapping", "write"),
        ("nav_msgs/Path", {"poses": [{"x": 1}]}, r"poses\[0\]: no field 'x'", "it has header, pose"),
        ("std_msgs/Time", {"data": "then"}, "not text", "secs, nsecs"),
        ("std_msgs/Time", {"data": {"hours": 1}}, "no field 'hours' in Time", "secs, nsecs"),
        ("std_msgs/Duration", {"data": "now"}, "data: a message is a mapping", "secs"),
        ("std_msgs/Empty", {"x": 1}, "no field 'x' in std_msgs/Empty", "it has none"),
        ("std_msgs/Empty", 5, "not a whole number", "it has no fields"),
        ("geometry_msgs/PoseWithCovariance", {"covariance": [1]}, "has 36 numbers, not 1", ""),
        ("sensor_msgs/LaserScan", {"ranges": 5}, "ranges is a list", "write"),
        ("shape_msgs/Mesh", {"triangles": [{"vertex_indices": "x"}]}, "is a list, not text", ""),
    ],
)
def test_what_is_wrong_and_where_is_said(type_name: str, content: object, error: str, hint: str) -> None:
    with pytest.raises(ConfigurationError, match=error) as refusal:
        filled(type_name, content)
    assert hint in refusal.value.hint


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
    refused(empty("topic", "pub", "/chatter", STRING, "{data: [", "--as", "/talker"), "cannot parse")


def test_fields_named_as_keywords_of_python_are_filled_shown_and_come_back() -> None:
    register_type("keyword_msgs/Inner", "float64 class")
    definition = "Inner from\nInner[] self\nstring None\nfloat32[2] is"
    kind = register_type("keyword_msgs/Outer", definition)
    message = kind.create()
    given = {"from": {"class": 1.5}, "self": [{"class": 2.5}], "None": "x", "is": [1, 2]}
    fill(message, given)
    assert plain(kind.deserialize(kind.serialize(message))) == given
    again = kind.create()
    fill(again, parse_message(render(message)))
    assert plain(again) == given
    assert flat(message)["self[0].class"] == "2.5"


@pytest.mark.parametrize(
    ("content", "refusal"), [([1], "1 value for 0 fields"), ({"a": [1]}, "no field 'a'")]
)
def test_a_message_without_fields_is_counted_in_words(content: object, refusal: str) -> None:
    with pytest.raises(ConfigurationError, match=refusal) as raised:
        fill(message_type("std_msgs/Empty").create(), content)
    assert "in this order" not in raised.value.hint


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (("topic", "pub", "/p", "geometry_msgs/PoseStamped"), "{header: {frame_id: map}}"),
        (("service", "call", "/s"), "{data: true}"),
        (("param", "set", "/p"), "[1, 2]"),
    ],
)
def test_a_message_that_the_shell_made_words_of_is_given_back_in_quotes(
    shell: Shell, command: tuple[str, ...], words: str
) -> None:
    said = shell(*command, *words.split(" "), "--as", "/robot")
    refused(said, f"the shell made {len(words.split())} words of the ", f"in single quotes: '{words}'")


def test_several_values_of_one_message_are_no_mistake() -> None:
    assert parse_arguments(["1", "{a: 2}", "[3, 4]"]) == [1, {"a": 2}, [3, 4]]
    with pytest.raises(ConfigurationError, match="cannot parse"):
        parse_arguments(["{a", "b"])
