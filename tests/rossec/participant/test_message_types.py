from pathlib import Path

import numpy as np
import pytest

from rossec.errors import MessageError
from rossec.participant.message_types import (
    MessageType,
    element_of,
    element_type,
    field_names,
    field_value,
    message_type,
    register_type,
    registered_type,
    set_field,
    type_names,
)

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
    assert "ROS_PACKAGE_PATH" in caught.value.hint


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


KEYWORDS = "float64 from\nstring class\nint32 self\nstring[] None\nuint8[2] def"


def test_fields_named_as_keywords_of_python_are_created_set_and_sent() -> None:
    kind = register_type("keyword_msgs/Keywords", KEYWORDS)
    fields = {"from": 1.5, "class": "chair", "self": 7, "None": ["a"]}
    message = kind.create(**fields)
    assert [field_value(message, field) for field in fields] == [1.5, "chair", 7, ["a"]]
    assert kind.create(class_="chair").class_ == "chair"
    again = kind.deserialize(kind.serialize(message))
    set_field(again, "def", np.array([1, 2], np.uint8))
    assert field_value(kind.deserialize(kind.serialize(again)), "def").tolist() == [1, 2]
    with pytest.raises(MessageError, match="no field 'for' in keyword_msgs/Keywords"):
        kind.create(**{"for": 1})


def test_two_fields_that_would_be_one_attribute_are_refused() -> None:
    with pytest.raises(MessageError, match="two fields of one name"):
        register_type("keyword_msgs/Twice", "float64 from\nfloat64 from_")


def test_elements_of_lists_have_a_zero_and_a_type() -> None:
    goal = message_type("actionlib_msgs/GoalStatusArray").create()
    assert element_type(goal, "status_list") == "actionlib_msgs/GoalStatus"
    zero = element_of(goal, "status_list")()
    assert field_names(zero) == ["goal_id", "status", "text"]
    path = message_type("trajectory_msgs/JointTrajectory").create()
    assert element_type(path, "joint_names") == "string"
    assert element_of(path, "joint_names")() == ""
    register_type("test_msgs/Times", "time[] when\nduration[2] long\n")
    times = message_type("test_msgs/Times").create()
    assert (element_type(times, "when"), element_type(times, "long")) == ("time", "duration")
    assert element_of(times, "when")().sec == 0
    assert len(times.long) == 2


def test_known_types_are_listed_by_their_names_in_ros() -> None:
    names = type_names()
    assert {"std_msgs/String", "geometry_msgs/PoseStamped"} <= set(names)
    assert not any("/msg/" in name for name in names)


def test_a_type_of_a_package_on_this_host_is_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "kitchen_msgs"
    (package / "msg").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>kitchen_msgs</name></package>")
    (package / "msg" / "Oven.msg").write_text("float64 heat\n")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    with pytest.raises(MessageError, match="unknown message type"):
        registered_type("kitchen_msgs/Oven")
    assert message_type("kitchen_msgs/Oven").create(heat=1.5).heat == 1.5
    assert registered_type("kitchen_msgs/Oven").definition == "float64 heat\n"


def test_what_is_no_definition_registers_nothing() -> None:
    with pytest.raises(MessageError, match="cannot register test_msgs/Odd"):
        register_type("test_msgs/Odd", "this is = not a (definition")
    with pytest.raises(MessageError, match="cannot register"):
        register_type("std_msgs/String", "float64 data\n")
    with pytest.raises(MessageError, match="unknown message type"):
        registered_type("test_msgs/Odd")
