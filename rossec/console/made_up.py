"""A minute of messages that nobody sent, for pages without a preview. Pure, and always the same.

A drive in a circle, a room around a laser, a picture of a room; for other types a message whose
numbers move. They go through the real filters (`samples.see`), and the page says that they are
made up.
"""

import math
from collections.abc import Iterable
from dataclasses import is_dataclass
from functools import cache
from typing import Any, Final

import numpy as np

from grants.model import Restriction
from rossec.console.samples import Recorded
from rossec.errors import MessageError
from rossec.participant.message_types import (
    field_names,
    field_value,
    message_type,
    set_field,
)

_FRAME: Final = "map"
_SECONDS: Final = 60
_LONG: Final = 600  # seconds at one message each, where a receiver gets one in a slot of 30 or 60
_RAYS: Final = 180
_WIDTH, _HEIGHT = 160, 120
_PER_SECOND: Final = 4


def recorded(
    topic: str, type_name: str, restrictions: Iterable[Restriction] = ()
) -> Recorded | None:
    """A minute of the topic, ten where one is in slots; None for a type that is not known here."""
    in_slots = any(each.slot is not None for each in restrictions)
    is_long = in_slots and type_name not in _RARE  # of these only the last is drawn
    try:
        return Recorded(topic, type_name, messages(type_name, is_long=is_long), is_made_up=True)
    except MessageError:
        return None


@cache
def messages(type_name: str, *, is_long: bool = False) -> tuple[tuple[float, bytes], ...]:
    """Messages of the type with their seconds from the beginning; made once."""
    kind = message_type(type_name)
    make = _MAKERS.get(type_name, _anything)
    rare = type_name in _RARE
    seconds = _LONG if is_long else _SECONDS
    usual = seconds * (1 if is_long else _PER_SECOND)
    count = 3 if rare else usual
    step = seconds / count
    found = []
    for number in range(count):
        at = number * step
        message = kind.create()
        make(message, at)
        _stamp(message, at, number)
        found.append((at, bytes(kind.serialize(message))))
    return tuple(found)


def _stamp(message: Any, at: float, number: int) -> None:
    header = getattr(message, "header", None)
    if header is None or not hasattr(header, "frame_id"):
        return
    header.frame_id = _FRAME
    header.stamp.sec, header.stamp.nanosec = int(at), int(at % 1 * 1e9)
    if hasattr(header, "seq"):
        header.seq = number


def _turn(at: float) -> float:
    """The angle of a drive that goes once around in a little more than a minute."""
    return 0.9 * 2 * math.pi * at / _SECONDS + math.pi / 2


def _pose(pose: Any, at: float) -> None:
    angle = _turn(at)
    _place(pose.position, at)
    heading = angle + math.pi / 2
    pose.orientation.z, pose.orientation.w = math.sin(heading / 2), math.cos(heading / 2)


def _place(position: Any, at: float) -> None:
    angle = _turn(at)
    position.x, position.y = 1.37 + 3 * math.cos(angle), 2.71 + 3 * math.sin(angle)


def _on_earth(message: Any, at: float) -> None:
    angle = _turn(at)
    message.latitude = 47.0707 + 0.0011 * math.sin(angle)
    message.longitude = 15.4395 + 0.0016 * math.cos(angle)


def _scan(message: Any, at: float) -> None:
    """A room of 7 by 5 metres with a door, and something round in it that moves a little."""
    message.angle_min, message.angle_increment = -math.pi, 2 * math.pi / _RAYS
    message.angle_max, message.range_max = math.pi, 12.0
    angles = -math.pi + np.arange(_RAYS) * 2 * math.pi / _RAYS
    wide = 3.5 / np.maximum(np.abs(np.cos(angles)), 1e-6)
    high = 2.5 / np.maximum(np.abs(np.sin(angles)), 1e-6)
    walls = np.minimum(wide, high)
    walls[(angles > 0.1) & (angles < 0.35)] = 6.0
    walls[np.abs(angles - 2.2 - 0.1 * math.sin(at)) < 0.12] = 1.6
    message.ranges = walls.astype(np.float32)
    message.intensities = np.zeros(0, dtype=np.float32)


def _image(message: Any, at: float) -> None:
    """A room: wall, floor, a window, a lamp, and somebody who stands in it."""
    rows, columns = np.mgrid[0:_HEIGHT, 0:_WIDTH]
    picture = np.empty((_HEIGHT, _WIDTH, 3), dtype=np.uint8)
    picture[:] = (214, 205, 190)
    picture[rows > 82] = (150, 118, 86)
    picture[(rows > 16) & (rows < 58) & (columns > 14) & (columns < 62)] = (140, 184, 224)
    picture[
        ((columns == 38) & (rows > 16) & (rows < 58))
        | ((rows == 37) & (columns > 14) & (columns < 62))
    ] = (250, 250, 250)
    at_x = 104 + int(6 * math.sin(at))
    picture[(rows - 40) ** 2 + (columns - at_x) ** 2 < 90] = (196, 150, 120)
    picture[(rows > 49) & (rows < 88) & (abs(columns - at_x) < 13)] = (48, 74, 132)
    picture[(rows > 87) & (rows < 108) & (abs(columns - at_x) < 9)] = (40, 42, 54)
    message.height, message.width, message.step = _HEIGHT, _WIDTH, 3 * _WIDTH
    message.encoding, message.data = "rgb8", picture.reshape(-1)


def _anything(message: Any, at: float) -> None:
    """Every number moves, every text is its field's name."""
    for field in field_names(message):
        value = field_value(message, field)
        if is_dataclass(value):
            _anything(value, at)
        elif isinstance(value, float):
            set_field(message, field, round(20.7 + 2.4 * math.sin(at / 6), 2))
        elif isinstance(value, str):
            set_field(message, field, f"some {field.replace('_', ' ')}")
        elif type(value) is int:
            set_field(message, field, 3)


_RARE: Final = frozenset({"sensor_msgs/LaserScan", "sensor_msgs/Image"})
_MAKERS: Final = {
    "geometry_msgs/Pose": _pose,
    "geometry_msgs/PoseStamped": lambda message, at: _pose(message.pose, at),
    "geometry_msgs/PoseWithCovarianceStamped": lambda message, at: _pose(message.pose.pose, at),
    "geometry_msgs/PointStamped": lambda message, at: _place(message.point, at),
    "geometry_msgs/TransformStamped": lambda message, at: _place(message.transform.translation, at),
    "nav_msgs/Odometry": lambda message, at: _pose(message.pose.pose, at),
    "sensor_msgs/NavSatFix": _on_earth,
    "sensor_msgs/LaserScan": _scan,
    "sensor_msgs/Image": _image,
}
