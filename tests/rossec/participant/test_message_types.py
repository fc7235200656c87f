import numpy as np
import pytest

from rossec.errors import MessageError
from rossec.participant.message_types import MessageType, message_type, register_type

STANDARD = [
    "std_msgs/String",
    "geometry_msgs/PoseStamped",
    "sensor_msgs/LaserScan",
    "sensor_msgs/Image",
    "diagnostic_msgs/DiagnosticArray",
    "nav_msgs/Odometry",
]


@pytest.mark.parametrize("name", STANDARD)
def test_a_zero_message_is_serialized_and_deserialized(name: str) -> None:
    kind = message_type(name)
    data = bytes(kind.serialize(kind.create()))
    assert bytes(kind.serialize(kind.deserialize(data))) == data
    assert not any(data)


def test_md5_and_definition_are_those_of_ros() -> None:
    kind = message_type("geometry_msgs/PoseStamped")
    assert kind.md5sum == "d3812c3cbc69362b77dc0b19b345f8f5"
    assert kind.definition.startswith("std_msgs/Header header\n")
    assert "msg/" not in kind.definition.replace("std_msgs/", "").replace("geometry_msgs/", "")


def test_fixed_arrays_have_their_length_and_type() -> None:
    covariance = message_type("geometry_msgs/PoseWithCovariance").create().covariance
    assert covariance.shape == (36,)
    assert covariance.dtype == np.float64


def test_create_sets_fields() -> None:
    assert message_type("std_msgs/String").create(data="hello").data == "hello"


def test_the_error_for_an_unknown_field_lists_the_fields() -> None:
    with pytest.raises(MessageError, match="no field 'dta' in std_msgs/String") as caught:
        message_type("std_msgs/String").create(dta="x")
    assert caught.value.hint == "it has data"


@pytest.mark.parametrize("name", ["std_msgs/Nothing", "nowhere/Thing"])
def test_an_unknown_type_is_refused(name: str) -> None:
    with pytest.raises(MessageError, match="unknown message type") as caught:
        message_type(name)
    assert "register_type" in caught.value.hint


@pytest.mark.parametrize("name", ["String", "std_msgs/", "/String", "std_msgs/msg/String", ""])
def test_an_invalid_type_name_is_refused(name: str) -> None:
    with pytest.raises(MessageError, match="not a message type name"):
        message_type(name)


def test_a_value_of_a_wrong_type_is_refused() -> None:
    kind = message_type("std_msgs/String")
    with pytest.raises(MessageError, match="cannot serialize this as std_msgs/String"):
        kind.serialize(kind.create(data=7))


@pytest.mark.parametrize("data", [b"", b"\x05\0\0\0ab", b"\x01\0\0\0a-tail"])
def test_malformed_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(MessageError, match="not one std_msgs/String"):
        message_type("std_msgs/String").deserialize(data)


def test_a_registered_type() -> None:
    kind = register_type("house_msgs/Lamp", "std_msgs/Header header\nuint8 level\nstring[] rooms\n")
    assert isinstance(kind, MessageType)
    message = kind.create(level=7, rooms=["attic"])
    again = kind.deserialize(kind.serialize(message))
    assert (again.level, again.rooms) == (7, ["attic"])


def test_an_invalid_definition_is_refused() -> None:
    with pytest.raises(MessageError, match="cannot register house_msgs/Bad"):
        register_type("house_msgs/Bad", "this is no definition ::")


def test_arrays_of_messages_and_strings_begin_empty() -> None:
    register_type("house_msgs/Pair", "string[2] names\ngeometry_msgs/Point[2] corners\n")
    message = message_type("house_msgs/Pair").create()
    assert message.names == ["", ""]
    assert [corner.x for corner in message.corners] == [0.0, 0.0]
