"""Messages made from values."""

import struct

import pytest

from grants.errors import MessageRefused
from grants.policy.assertions import Value, below, read_back, serialize
from rossec.authority.policyfile import layout_of
from rossec.participant.message_types import message_type, type_names

POSE = layout_of("geometry_msgs/PoseStamped")


def test_values_are_read_back() -> None:
    values: dict[str, Value] = {"header.frame_id": "map", "header.stamp": 12.5, "pose.position.x": -3.25}
    read = read_back(POSE, serialize(POSE, values))
    assert {path: value for path, value in read.items() if value} == values


@pytest.mark.parametrize("name", sorted(type_names()))
def test_zero_messages_are_those_of_the_library(name: str) -> None:
    """But for arrays, which have one element here."""
    layout = layout_of(name)
    data = serialize(layout, {})
    read = read_back(layout, data)
    assert read.keys() == layout.leaves().keys()
    assert all(value in (0, "", None) for value in read.values())
    message_type(name).deserialize(data)


def test_the_first_element_of_an_array_is_read() -> None:
    scan = layout_of("sensor_msgs/LaserScan")
    assert read_back(scan, serialize(scan, {"ranges": 1.5}))["ranges"] == 1.5
    empty = serialize(scan, {})[:-16] + bytes(8)
    assert read_back(scan, empty)["ranges"] is None


def test_parts_of_a_field_are_found() -> None:
    paths = POSE.leaves()
    assert below(paths, "pose.position") == [f"pose.position.{axis}" for axis in "xyz"]
    assert below(paths, "pose.position.x") == ["pose.position.x"]
    assert below(paths, "pose.pos") == []
    path = layout_of("nav_msgs/Path").leaves()
    assert below(path, "poses.header.seq") == ["poses[*].header.seq"]


def test_values_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="far"):
        serialize(POSE, {"pose.position.x": "far"})
    with pytest.raises(struct.error):
        serialize(POSE, {"header.seq": -1})


@pytest.mark.parametrize("data", [b"", serialize(POSE, {}) + b"x", b"\xff" * 30])
def test_other_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(MessageRefused):
        read_back(POSE, data)
