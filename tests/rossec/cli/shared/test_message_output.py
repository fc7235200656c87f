"""Messages printed as rostopic prints them; what is printed can be published again."""

import io
from typing import Any

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

from rossec.cli.shared import messages
from rossec.participant.message_types import message_type

STRING = "std_msgs/String"
TYPES = (
    "geometry_msgs/PoseStamped",
    "sensor_msgs/LaserScan",
    "sensor_msgs/JointState",
    "sensor_msgs/Image",
    "nav_msgs/Path",
    "nav_msgs/Odometry",
    "sensor_msgs/Imu",
    "diagnostic_msgs/DiagnosticArray",
    "std_msgs/Time",
    "std_msgs/Duration",
    "std_msgs/Bool",
    "std_msgs/Empty",
    "std_msgs/UInt8MultiArray",
    "sensor_msgs/CameraInfo",
    "sensor_msgs/PointCloud2",
    "trajectory_msgs/JointTrajectory",
    "visualization_msgs/MarkerArray",
)


def filled(type_name: str, content: object) -> Any:
    message = message_type(type_name).create()
    messages.fill(message, content)
    return message


def shown(type_name: str, content: object) -> str:
    return messages.render(filled(type_name, content))


def test_times_have_the_names_of_ros_1() -> None:
    assert shown("std_msgs/Header", {"stamp": {"secs": 5, "nsecs": 12}, "frame_id": "map"}) == (
        'seq: 0\nstamp: \n  secs: 5\n  nsecs:        12\nframe_id: "map"'
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "''"),
        ("hello", '"hello"'),
        ("5", '"5"'),
        ('say "no" \\', '"say \\"no\\" \\\\"'),
        ("a\n---\ndata: \x1b[2J\u202eb", '"a\\n---\\ndata: \\u001b[2J\\u202eb"'),
        ("Zimmer für 🤖", '"Zimmer für 🤖"'),
    ],
)
def test_text_of_a_peer_stays_on_its_line(text: str, expected: str) -> None:
    line = shown(STRING, {"data": text})
    assert line == f"data: {expected}"
    assert messages.parse_message(line) == {"data": text}


@pytest.mark.parametrize(
    ("value", "expected"),
    [(1e-5, "1.0e-05"), (float("nan"), ".nan"), (float("-inf"), "-.inf"), (1e22, "1.0e+22")],
)
def test_every_number_comes_back(value: float, expected: str) -> None:
    line = shown("std_msgs/Float64", {"data": value})
    assert line == f"data: {expected}"
    assert repr(messages.parse_message(line)) == repr({"data": value})


def test_lists() -> None:
    scan = filled("sensor_msgs/LaserScan", {"ranges": [1, 2.5] * 1000})
    assert "\nranges: [1.0, 2.5, 1.0, 2.5," in messages.render(scan)
    assert "\nintensities: []" in messages.render(scan)
    joints = shown("sensor_msgs/JointState", {"name": ["left", "a\n', '"]})
    assert '\nname: \n  - "left"\n  - "a\\n\', \'"\nposition: []' in joints
    path = {"poses": [{"header": {"frame_id": "map"}}] * 2}
    text = shown("nav_msgs/Path", path)
    assert text.count("\n  - \n    header: \n      seq: 0\n") == 2


def test_what_is_hidden_has_its_length() -> None:
    joints = filled("sensor_msgs/JointState", {"name": ["left"], "header": {"frame_id": "map"}})
    assert messages.render(joints, 0, (str,)).endswith(
        'frame_id: "<string length: 3>"\nname: "<array type: string, length: 1>"\n'
        "position: []\nvelocity: []\neffort: []"
    )
    assert '\nposition: "<array type: float64, length: 0>"' in messages.render(joints, 0, (list,))
    path = filled("nav_msgs/Path", {"poses": [{}, {}]})
    assert messages.render(path, 0, (list,)).endswith(
        '\nposes: "<array type: geometry_msgs/PoseStamped, length: 2>"'
    )


def test_values_by_the_paths_of_their_fields() -> None:
    path = filled("nav_msgs/Path", {"poses": [{"pose": {"position": {"x": 3}}}]})
    found = messages.flat(path)
    assert found["poses[0].pose.position.x"] == "3.0"
    assert found["header.stamp.nsecs"] == "0"
    assert messages.flat(filled("nav_msgs/Path", {}))["poses"] == "[]"


def test_json_has_the_same_names() -> None:
    pose = filled("geometry_msgs/PoseStamped", {"header": {"stamp": 1_000_000_005}})
    plain: Any = messages.plain(pose)
    assert plain["header"]["stamp"] == {"secs": 1, "nsecs": 5}
    assert plain["pose"]["position"] == {"x": 0.0, "y": 0.0, "z": 0.0}
    names = filled("sensor_msgs/JointState", {"name": ["a"], "position": [1]})
    made: Any = messages.plain(names)
    assert (made["name"], made["position"]) == (["a"], [1.0])


def stock(type_name: str, dice: np.random.Generator) -> Any:
    """A message of Debian's class with anything in it."""
    import genpy.message

    kind = genpy.message.get_message_class("std_msgs/Header" if type_name == "Header" else type_name)
    message = kind()
    for field, slot in zip(kind.__slots__, kind._slot_types, strict=True):
        setattr(message, field, anything(slot, dice))
    return message


def anything(slot: str, dice: np.random.Generator) -> Any:
    base, _, length = slot.partition("[")
    if length:
        fixed = length.rstrip("]")
        made = [anything(base, dice) for _ in range(int(fixed) if fixed else dice.integers(3))]
        return bytes(made) if base in ("uint8", "char") else made
    if "/" in base or base == "Header":
        return stock(base, dice)
    return BASE.get(base, number)(base, dice)


def moment(base: str, dice: np.random.Generator) -> Any:
    import genpy

    kind = genpy.Time if base == "time" else genpy.Duration
    return kind(int(dice.integers(1 << 31)), int(dice.integers(10**9)))


def word(_base: str, dice: np.random.Generator) -> str:
    words = ("", "map", "7", "yes", "a: b", "null", "x\ny", "'\"\\", "ä🤖", "~")
    return words[dice.integers(len(words))]


def number(base: str, dice: np.random.Generator) -> Any:
    if base == "bool":
        return bool(dice.integers(2))
    if base.startswith("float"):
        values = (0.0, -1.5, 1e-9, 1e300 if base == "float64" else 1e30, 3.0)
        return float(np.dtype(base).type(values[dice.integers(len(values))]))
    info = np.iinfo({"byte": "int8", "char": "uint8"}.get(base, base))
    return int(dice.integers(info.min, info.max, dtype=info.dtype, endpoint=True))


BASE = {"time": moment, "duration": moment, "string": word}


def serialized(message: Any) -> bytes:
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


@pytest.mark.ros
@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32))
@pytest.mark.parametrize("type_name", TYPES)
def test_rostopic_takes_what_is_printed_and_the_reverse(type_name: str, seed: int) -> None:
    import genpy.message
    import yaml

    theirs = stock(type_name, np.random.default_rng(seed))
    data = serialized(theirs)
    kind = message_type(type_name)
    text = messages.render(kind.deserialize(data))

    again = type(theirs)()
    genpy.message.fill_message_args(again, [yaml.safe_load(text)] if text else [])
    assert serialized(again) == data

    printed = genpy.message.strify_message(theirs)
    for written in (text, printed):
        ours = kind.create()
        messages.fill(ours, messages.parse_message(written) if written else {})
        assert bytes(kind.serialize(ours)) == data
