"""What the fields of a message show, as lint tells them apart: by the vocabulary, then by names.

`grants.vocabulary` says what each field of a standard type contains, wherever that is nested. Where
it knows nothing of a number, its name may say it; where a topic has no type, the topic's name. The
map of a house is not where the robot is, so only local maps count.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Final

from grants.filters.layout import Array, Primitive, Type
from grants.vocabulary.contents import Content
from grants.vocabulary.describe import Description, FieldContent


class Aspect(StrEnum):
    """What a field shows."""

    POSITION = "position"
    HEADING = "orientation"
    MOVEMENT = "movement"
    COVARIANCE = "covariance"
    TIME = "time"
    COUNT = "count"
    SURROUNDINGS = "surroundings"
    IMAGE = "image"
    NAME = "name"
    JOINT = "joints"
    JOINT_RATE = "movement of joints"
    STATE = "state"  # of a battery, a goal, an air: it changes with where that is
    WARMTH = "temperature"
    HUMIDITY = "humidity"
    LIGHT = "brightness"
    PLAN = "map"
    SOUND = "sound"
    MARK = "mark"
    NOTHING = "nothing"


_OF: Final[Mapping[Content, Aspect]] = {
    Content.COORDINATE: Aspect.POSITION,
    Content.DEGREES: Aspect.POSITION,
    Content.HEIGHT: Aspect.POSITION,
    Content.HEADING: Aspect.HEADING,
    Content.VELOCITY: Aspect.MOVEMENT,
    Content.CONTROL: Aspect.MOVEMENT,
    Content.UNCERTAINTY: Aspect.COVARIANCE,
    Content.TIME: Aspect.TIME,
    Content.COUNT: Aspect.COUNT,
    Content.DISTANCE: Aspect.SURROUNDINGS,
    Content.MAP: Aspect.SURROUNDINGS,
    Content.PICTURE: Aspect.IMAGE,
    Content.COMPRESSED_PICTURE: Aspect.IMAGE,
    Content.NAME: Aspect.NAME,
    Content.REQUEST: Aspect.NAME,
    Content.MARK: Aspect.MARK,
    Content.WEAR: Aspect.MARK,
    Content.FORCE: Aspect.MOVEMENT,
    Content.SAMPLES: Aspect.SOUND,
    Content.STATE: Aspect.STATE,
    Content.CHARGE: Aspect.STATE,
    Content.PRESSURE: Aspect.STATE,
    Content.TEMPERATURE: Aspect.WARMTH,
    Content.AMBIENT_TEMPERATURE: Aspect.WARMTH,
    Content.HUMIDITY: Aspect.HUMIDITY,
    Content.AMBIENT_HUMIDITY: Aspect.HUMIDITY,
    Content.BRIGHTNESS: Aspect.LIGHT,
    Content.AMBIENT_BRIGHTNESS: Aspect.LIGHT,
    Content.JOINT: Aspect.JOINT,
}
_NUMBERS_ONLY: Final = frozenset({Content.UNCERTAINTY, Content.DISTANCE, Content.MAP})
"""Beside the values these have sizes and states, which alone show little."""
AMBIENT: Final = frozenset({
    Content.AMBIENT_TEMPERATURE, Content.AMBIENT_HUMIDITY, Content.AMBIENT_BRIGHTNESS,
})  # fmt: skip
"""Of a sensor that may be carried about, so the room follows from it."""
DEPTH: Final = frozenset({
    "sensor_msgs/PointCloud", "sensor_msgs/PointCloud2", "stereo_msgs/DisparityImage",
})  # fmt: skip
"""Types in whose points a person is recognised as in a picture; the names of their topics."""
CLOUDS: Final = ("points", "pointcloud")
_STEADY: Final = ("diagnostic_msgs/", "tf2_msgs/")  # their states hardly tell where something is
_RATES: Final = ("velocity", "velocities", "accelerations", "effort")
_NAMED: Final[Mapping[str, Aspect]] = {
    **dict.fromkeys(("x", "y", "latitude", "longitude", "lat", "lon", "lng"), Aspect.POSITION),
    **dict.fromkeys(("theta", "yaw", "heading"), Aspect.HEADING),
    **dict.fromkeys(
        ("vx", "vy", "speed", "velocity", "linear_velocity", "angular_velocity"), Aspect.MOVEMENT
    ),
}
_CONVENTIONS: Final[Mapping[str, Aspect]] = {
    **dict.fromkeys(("tf", "odom", "amcl_pose", "pose", "plan", "path", "fix"), Aspect.POSITION),
    **dict.fromkeys(("cmd_vel", "imu"), Aspect.MOVEMENT),
    **dict.fromkeys(("mag", "compass", "magnetic_field"), Aspect.HEADING),
    **dict.fromkeys(("battery", "battery_state", "barometer", "fluid_pressure"), Aspect.STATE),
    **dict.fromkeys(("audio", "microphone", "mic"), Aspect.SOUND),
    "joint_states": Aspect.JOINT,
    **dict.fromkeys(("scan", *CLOUDS), Aspect.SURROUNDINGS),
    **dict.fromkeys(("camera", "image", "image_raw", "image_color", "compressed"), Aspect.IMAGE),
    **dict.fromkeys(
        ("clock", "rosout", "rosout_agg", "map", "camera_info", "tf_static"), Aspect.NOTHING
    ),
}
EVERYWHERE: Final = ("/tf", "/odom", "/amcl_pose", "/scan", "/cmd_vel", "/camera/image_raw", "/fix")
"""Topics of most robots, which a pattern may cover though no line names them."""


def aspects(described: Description, topic: str = "") -> dict[str, Aspect]:
    """What each leaf of a message shows, by its path; leaves that show nothing are left out."""
    found = {field.path: _aspect(field, described, topic) for field in described.fields}
    return {path: aspect for path, aspect in found.items() if aspect is not Aspect.NOTHING}


def is_known(described: Description) -> bool:
    """Whether it is known what the type shows: no field is unknown, or names say enough."""
    if all(field.content is not Content.UNKNOWN for field in described.fields):
        return True
    return any(_by_name(field) is not Aspect.NOTHING for field in described.fields)


def conventional(topic: str) -> Aspect | None:
    """What a topic whose type is not given shows by its name; None if that says nothing."""
    named = [segment for segment in topic.split("/") if "*" not in segment]
    return _CONVENTIONS.get(named[-1])  # the first is empty


def _aspect(field: FieldContent, described: Description, topic: str) -> Aspect:
    if field.content is Content.UNKNOWN:
        return _by_name(field)
    if _shows_little(field, described):
        return Aspect.NOTHING
    if field.content is Content.MAP and "local" not in topic:
        return Aspect.PLAN
    if field.content is Content.UNCERTAINTY:
        return _of_uncertainty(field, described)
    if field.content is Content.JOINT and _last(field.path) in _RATES:
        return Aspect.JOINT_RATE
    return _OF.get(field.content, Aspect.NOTHING)


def _shows_little(field: FieldContent, described: Description) -> bool:
    steady = field.content is Content.STATE and described.type_name.startswith(_STEADY)
    return steady or (field.content in _NUMBERS_ONLY and not _is_value(field.kind))


def _of_uncertainty(field: FieldContent, described: Description) -> Aspect:
    if _is_of_velocity(field, described):
        return Aspect.MOVEMENT  # to be cleared with it, as one message
    if field.path.endswith("covariance"):
        return Aspect.COVARIANCE
    return Aspect.POSITION  # a policy says of its own type that the field tells a position


def _is_value(kind: Type) -> bool:
    return isinstance(kind, Array) or (isinstance(kind, Primitive) and kind.code in ("f", "d"))


def _is_of_velocity(field: FieldContent, described: Description) -> bool:
    """Whether the message the field is in has a velocity."""
    above = field.path.rpartition(".")[0]
    return any(
        other.content is Content.VELOCITY and other.path.startswith(above)
        for other in described.fields
    )


def _by_name(field: FieldContent) -> Aspect:
    if field.content is not Content.UNKNOWN or not isinstance(field.kind, Primitive):
        return Aspect.NOTHING
    return _NAMED.get(_last(field.path), Aspect.NOTHING)


def _last(path: str) -> str:
    return path.rpartition(".")[2]
