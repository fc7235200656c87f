"""What the fields of the standard message types contain, and which words each content tells.

`tells` are exact relatives: the word can be computed from the field, as the path from a velocity. `hints` are
what a person or a program recognises in it, as a face in a picture; a rule that says a level for the field's
own word has decided on them. Times tell when a value changed. The figures are those of the attackers'
programs, in docs/spec/vocabulary.md. Types within a type are described by the same table. What is neither in
it nor in the policy's own vocabulary is `unknown`: nothing of it can be said to be hidden.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Final, NamedTuple, Self

from grants.filters.layout import Array, Layout, Struct, Type

EXACT: Final = "exact"
NO: Final = "no"


class DataWord(StrEnum):
    POSITION = "position"
    MOVEMENT = "movement"
    IMAGE = "image"
    SOUND = "sound"
    PRESENCE = "presence"
    IDENTITY = "identity"
    HOME = "home"


# From the most to the least that is shown. A level is an upper limit: each lets through no more than the
# one before.
LEVELS: Final[Mapping[DataWord, tuple[str, ...]]] = {
    DataWord.POSITION: (EXACT, "room", "area", NO),
    DataWord.MOVEMENT: (EXACT, "rough", NO),
    DataWord.IMAGE: (EXACT, "blurred", NO),
    DataWord.SOUND: (EXACT, NO),
    # There is no `no`: a message that arrives tells that its sender works.
    DataWord.PRESENCE: (EXACT, "minute", "hour"),
    DataWord.IDENTITY: (EXACT, "pseudonym", NO),
    DataWord.HOME: (EXACT, "rough", NO),
}


def rank(word: DataWord, level: str) -> int:
    """The place of a level in the order of its word; 0 is `exact`."""
    return LEVELS[word].index(level)


class Content(StrEnum):
    """What one field contains; the names are also those of a policy's `vocabulary`."""

    COORDINATE = "coordinate"  # metres in a frame
    DEGREES = "degrees"  # of latitude and longitude
    HEIGHT = "height"  # above the sea: the ground tells where
    DISTANCE = "distance"  # measured by rays: scans, ranges, clouds of points
    MAP = "map"
    FRAME = "frame"  # the frame that coordinates are in
    CHILD_FRAME = "child-frame"
    HEADING = "heading"
    VELOCITY = "velocity"  # and acceleration
    FORCE = "force"
    JOINT = "joint"
    CONTROL = "control"  # what a person steers by
    UNCERTAINTY = "uncertainty"
    PICTURE = "picture"  # the pixels of a sensor_msgs/Image
    COMPRESSED_PICTURE = "compressed-picture"
    PICTURE_PART = "picture-part"  # the region of a picture that is of interest
    SAMPLES = "samples"  # of sound
    NAME = "name"  # a text that names a device, a person, a part
    REQUEST = "request"  # a name that is made for each request, of its sender, time and number
    MARK = "mark"  # numbers that belong to one device: calibration, body
    TEMPERATURE = "temperature"  # degrees Celsius
    HUMIDITY = "humidity"  # 0 to 1
    BRIGHTNESS = "brightness"  # lux
    # The same of a sensor that may be carried about, as on a robot.
    AMBIENT_TEMPERATURE = "ambient-temperature"
    AMBIENT_HUMIDITY = "ambient-humidity"
    AMBIENT_BRIGHTNESS = "ambient-brightness"
    PRESSURE = "pressure"  # pascal
    CHARGE = "charge"  # 0 to 1
    WEAR = "wear"  # what differs from device to device, and changes with age: cells, capacity
    STATE = "state"  # of a device or a task: it changes with where that is and what it does
    READING = "reading"  # any other measured value or state
    TEXT = "text"  # for people: it may say anything
    TIME = "time"
    COUNT = "count"  # of messages
    FORMAT = "format"  # how the rest is to be read; tells nothing
    BARE = "bare"  # a value whose meaning only its topic knows
    UNKNOWN = "unknown"


Fields = Mapping[str, Content]


class Meaning(NamedTuple):
    own: DataWord | None
    tells: frozenset[DataWord]
    hints: frozenset[DataWord] = frozenset()

    @classmethod
    def of(cls, own: DataWord, *tells: DataWord) -> Self:
        return cls(own, frozenset((own, *tells)))


_P, _M, _I, _S, _W, _N, _H = DataWord
_ALL: Final = frozenset(DataWord)


MEANINGS: Final[Mapping[Content, Meaning]] = {
    Content.COORDINATE: Meaning.of(_P, _M),
    Content.DEGREES: Meaning.of(_P, _M),
    Content.HEIGHT: Meaning.of(_P, _M),
    # Rounded to 1 m, a scan gave the position to 0.015 m.
    Content.DISTANCE: Meaning.of(_P, _M, _I, _H),
    # A local map moves with the robot.
    Content.MAP: Meaning.of(_H, _P, _M),
    # Every header has one, so they are no word of their own; a frame may be called `kitchen`.
    Content.FRAME: Meaning(None, frozenset({_N}), frozenset({_P})),
    Content.CHILD_FRAME: Meaning(None, frozenset({_N}), frozenset({_P})),
    Content.HEADING: Meaning.of(_M, _P),
    # The path to 0.05 m, by integration; the joints are those of wheels, too.
    Content.VELOCITY: Meaning.of(_M, _P),
    Content.FORCE: Meaning.of(_M, _P),
    Content.JOINT: Meaning.of(_M, _P),
    Content.CONTROL: Meaning.of(_M, _P),
    Content.UNCERTAINTY: Meaning.of(_P, _M),
    Content.PICTURE: Meaning(_I, frozenset({_I}), frozenset({_P, _M, _N, _H})),
    Content.COMPRESSED_PICTURE: Meaning(_I, frozenset({_I}), frozenset({_P, _M, _N, _H})),
    Content.PICTURE_PART: Meaning(_I, frozenset({_I}), frozenset({_P, _M, _N, _H})),
    Content.SAMPLES: Meaning(_S, frozenset({_S}), frozenset({_P, _M, _N, _H})),
    Content.NAME: Meaning.of(_N),
    Content.REQUEST: Meaning.of(_N, *_ALL),
    Content.MARK: Meaning.of(_N),
    Content.TEMPERATURE: Meaning.of(_H),
    Content.HUMIDITY: Meaning.of(_H),
    Content.BRIGHTNESS: Meaning.of(_H),
    # A sensor that is carried through a home tells its rooms by their climate and lamps.
    Content.AMBIENT_TEMPERATURE: Meaning.of(_H, _P, _M),
    Content.AMBIENT_HUMIDITY: Meaning.of(_H, _P, _M),
    Content.AMBIENT_BRIGHTNESS: Meaning.of(_H, _P, _M),
    Content.PRESSURE: Meaning.of(_H, _P, _M),  # 12 Pa for each metre of height
    Content.CHARGE: Meaning.of(_H, _P, _M),  # it rises at the dock, and falls by driving
    Content.WEAR: Meaning.of(_H, _P, _M, _N),
    # A current is that of the wheels, a state that of a goal, a colour that of what is where.
    Content.STATE: Meaning.of(_H, _P, _M),
    Content.READING: Meaning.of(_H),
    Content.TEXT: Meaning(None, _ALL),  # and since when
    Content.TIME: Meaning.of(_W, *(_ALL - {_N})),
    Content.COUNT: Meaning.of(_W, *(_ALL - {_N})),
    Content.FORMAT: Meaning(None, frozenset()),
    Content.BARE: Meaning(None, _ALL),
    Content.UNKNOWN: Meaning(None, _ALL),
}

NOT_KNOWN: Final = frozenset({Content.BARE, Content.UNKNOWN})
TIMES: Final = frozenset({Content.TIME, Content.COUNT})
NAMES: Final = frozenset({Content.NAME, Content.REQUEST})
FRAMES: Final = frozenset({Content.FRAME, Content.CHILD_FRAME})


def fields_by(**contents: str) -> Fields:
    return {
        field: Content(content.replace("_", "-"))
        for content, fields in contents.items()
        for field in fields.split()
    }


_XYZ: Final = "x y z"
_BARE: Final = fields_by(bare="data")
_SCAN: Final = fields_by(
    format="angle_min angle_max angle_increment time_increment scan_time range_min range_max",
    distance="ranges intensities",
)
_ARRAYS: Final = "Byte Float32 Float64 Int16 Int32 Int64 Int8 UInt16 UInt32 UInt64 UInt8"
_NUMBERS: Final = f"Bool Char Duration String {_ARRAYS}"


def _nested(package: str, names: str) -> dict[str, Fields]:
    # Types whose fields are all messages, which have the contents of their own types.
    return {f"{package}/{name}": {} for name in names.split()}


# The types of Debian's std, geometry, sensor, nav, tf2, stereo, diagnostic, actionlib, trajectory and
# visualization packages, and the sound of audio_common. A field that is a message and is not named here has
# the contents of its own type; one that is named has this content throughout.
_STD: Final[dict[str, Fields]] = {
    **{f"std_msgs/{name}": _BARE for name in _NUMBERS.split()},
    **{f"std_msgs/{name}MultiArray": _BARE for name in _ARRAYS.split()},
    "std_msgs/Header": fields_by(count="seq", time="stamp", frame="frame_id"),
    "std_msgs/Time": fields_by(time="data"),
    "std_msgs/Empty": {},
    "std_msgs/ColorRGBA": fields_by(reading="r g b a"),  # of a lamp
    # How many values there are is told without them, and a label may say anything.
    "std_msgs/MultiArrayLayout": fields_by(count="data_offset"),
    "std_msgs/MultiArrayDimension": fields_by(text="label", count="size stride"),
}
_GEOMETRY: Final[dict[str, Fields]] = {
    **_nested(
        "geometry_msgs",
        "PointStamped Vector3Stamped QuaternionStamped Pose PoseStamped PoseArray "
        "PoseWithCovarianceStamped Polygon PolygonStamped TwistStamped TwistWithCovarianceStamped "
        "AccelStamped AccelWithCovarianceStamped WrenchStamped InertiaStamped",
    ),
    "geometry_msgs/Point": fields_by(coordinate=_XYZ),
    "geometry_msgs/Point32": fields_by(coordinate=_XYZ),
    "geometry_msgs/Vector3": fields_by(bare=_XYZ),
    "geometry_msgs/Quaternion": fields_by(heading="x y z w"),
    "geometry_msgs/Pose2D": fields_by(coordinate="x y", heading="theta"),
    "geometry_msgs/PoseWithCovariance": fields_by(uncertainty="covariance"),
    "geometry_msgs/Transform": fields_by(coordinate="translation", heading="rotation"),
    "geometry_msgs/TransformStamped": fields_by(child_frame="child_frame_id"),
    "geometry_msgs/Twist": fields_by(velocity="linear angular"),
    "geometry_msgs/TwistWithCovariance": fields_by(uncertainty="covariance"),
    "geometry_msgs/Accel": fields_by(velocity="linear angular"),
    "geometry_msgs/AccelWithCovariance": fields_by(uncertainty="covariance"),
    "geometry_msgs/Wrench": fields_by(force="force torque"),
    "geometry_msgs/Inertia": fields_by(mark="m com ixx ixy ixz iyy iyz izz"),
}
_SENSOR: Final[dict[str, Fields]] = {
    "sensor_msgs/BatteryState": fields_by(
        charge="percentage",
        state="voltage temperature current charge power_supply_status present",
        wear="capacity power_supply_health cell_voltage cell_temperature",
        mark="design_capacity power_supply_technology",
        name="location serial_number",
    ),
    "sensor_msgs/CameraInfo": fields_by(
        mark="distortion_model D K R P", format="height width binning_x binning_y", picture_part="roi"
    ),
    "sensor_msgs/ChannelFloat32": fields_by(format="name", distance="values"),
    "sensor_msgs/CompressedImage": fields_by(format="format", compressed_picture="data"),
    "sensor_msgs/FluidPressure": fields_by(pressure="fluid_pressure", state="variance"),
    "sensor_msgs/Illuminance": fields_by(ambient_brightness="illuminance", state="variance"),
    "sensor_msgs/Image": fields_by(format="height width encoding is_bigendian step", picture="data"),
    # The compass is in `orientation`; gyroscope and accelerometer give the path.
    "sensor_msgs/Imu": fields_by(
        velocity="angular_velocity linear_acceleration",
        uncertainty="orientation_covariance angular_velocity_covariance linear_acceleration_covariance",
    ),
    "sensor_msgs/JointState": fields_by(name="name", joint="position velocity effort"),
    "sensor_msgs/Joy": fields_by(control="axes buttons"),
    "sensor_msgs/JoyFeedback": fields_by(control="type id intensity"),
    "sensor_msgs/JoyFeedbackArray": {},
    "sensor_msgs/LaserEcho": fields_by(distance="echoes"),
    "sensor_msgs/LaserScan": _SCAN,
    "sensor_msgs/MultiEchoLaserScan": _SCAN,
    "sensor_msgs/MagneticField": fields_by(heading="magnetic_field", uncertainty="magnetic_field_covariance"),
    "sensor_msgs/MultiDOFJointState": fields_by(name="joint_names"),
    # Whether there is a fix, and how good it is, tells indoors from outdoors.
    "sensor_msgs/NavSatFix": fields_by(
        degrees="latitude longitude",
        height="altitude",
        uncertainty="status position_covariance position_covariance_type",
    ),
    "sensor_msgs/NavSatStatus": fields_by(uncertainty="status service"),
    # The number of points changes with what is seen, so a cloud is cleared as a whole.
    "sensor_msgs/PointCloud": fields_by(distance="points"),
    "sensor_msgs/PointCloud2": fields_by(
        format="fields is_bigendian point_step", distance="height width row_step data is_dense"
    ),
    "sensor_msgs/PointField": fields_by(format="name offset datatype count"),
    "sensor_msgs/Range": fields_by(
        format="radiation_type field_of_view min_range max_range", distance="range"
    ),
    "sensor_msgs/RegionOfInterest": fields_by(picture_part="x_offset y_offset height width do_rectify"),
    "sensor_msgs/RelativeHumidity": fields_by(ambient_humidity="relative_humidity", state="variance"),
    "sensor_msgs/Temperature": fields_by(ambient_temperature="temperature", state="variance"),
    "sensor_msgs/TimeReference": fields_by(time="time_ref", name="source"),
}
_NAV: Final[dict[str, Fields]] = {
    **_nested(
        "nav_msgs",
        "GetMapAction GetMapActionFeedback GetMapActionGoal GetMapActionResult GetMapFeedback"
        " GetMapGoal GetMapResult",
    ),
    "nav_msgs/GridCells": fields_by(map="cell_width cell_height cells"),
    "nav_msgs/MapMetaData": fields_by(time="map_load_time", map="resolution width height origin"),
    "nav_msgs/OccupancyGrid": fields_by(map="data"),
    "nav_msgs/Odometry": fields_by(child_frame="child_frame_id"),
    "nav_msgs/Path": {},
}
_FURTHER: Final[dict[str, Fields]] = {
    "tf2_msgs/TFMessage": {},
    "tf2_msgs/TF2Error": fields_by(state="error", text="error_string"),
    "tf/tfMessage": {},
    "stereo_msgs/DisparityImage": fields_by(
        distance="image.data min_disparity max_disparity",
        mark="f T",
        format="delta_d",
        picture_part="valid_window",
    ),
    "diagnostic_msgs/DiagnosticArray": {},
    "diagnostic_msgs/DiagnosticStatus": fields_by(
        state="level", name="name hardware_id", text="message values"
    ),
    "diagnostic_msgs/KeyValue": fields_by(text="key value"),
    "actionlib_msgs/GoalID": fields_by(time="stamp", request="id"),
    "actionlib_msgs/GoalStatus": fields_by(state="status", text="text"),
    "actionlib_msgs/GoalStatusArray": {},
    "trajectory_msgs/JointTrajectory": fields_by(name="joint_names"),
    "trajectory_msgs/JointTrajectoryPoint": fields_by(
        joint="positions velocities accelerations effort time_from_start"
    ),
    "trajectory_msgs/MultiDOFJointTrajectory": fields_by(name="joint_names"),
    "trajectory_msgs/MultiDOFJointTrajectoryPoint": fields_by(velocity="time_from_start"),
    "shape_msgs/Mesh": fields_by(mark="triangles vertices"),
    "shape_msgs/MeshTriangle": fields_by(mark="vertex_indices"),
    "shape_msgs/Plane": fields_by(map="coef"),
    "shape_msgs/SolidPrimitive": fields_by(mark="type dimensions"),
    "visualization_msgs/Marker": fields_by(
        name="ns id",
        format="frame_locked mesh_use_embedded_materials",
        coordinate="points scale",
        state="type action lifetime color colors",
        text="text mesh_resource",
    ),
    "visualization_msgs/MarkerArray": {},
    "audio_common_msgs/AudioData": fields_by(samples="data"),
    "audio_common_msgs/AudioDataStamped": {},
    "audio_common_msgs/AudioInfo": fields_by(
        format="channels sample_rate sample_format bitrate coding_format"
    ),
}

TYPES: Final[Mapping[str, Fields]] = {**_STD, **_GEOMETRY, **_SENSOR, **_NAV, **_FURTHER}


@dataclass(frozen=True)
class FieldContent:
    """One field without fields of its own."""

    path: str  # as in filters: `pose.position.x`, `poses[*].position.x`
    content: Content
    kind: Type
    array: str = ""  # the path of the outermost array of messages it lies in
    is_fixed: bool = False  # whether that array has a fixed length

    @property
    def meaning(self) -> Meaning:
        return MEANINGS[self.content]


@dataclass(frozen=True)
class Description:
    """The fields of one message type, in order of its definition."""

    type_name: str
    fields: tuple[FieldContent, ...]

    @cached_property
    def unknown(self) -> tuple[str, ...]:
        return tuple(field.path for field in self.fields if field.content in NOT_KNOWN)

    @cached_property
    def words(self) -> tuple[DataWord, ...]:
        own = {field.meaning.own for field in self.fields if field.content not in TIMES}
        return tuple(word for word in DataWord if word in own)

    @cached_property
    def has_names(self) -> bool:
        return any(field.content in NAMES for field in self.fields)

    @cached_property
    def is_outdoors(self) -> bool:
        """Whether a field is in degrees on the earth, so that cells are of kilometres."""
        return any(field.content is Content.DEGREES for field in self.fields)

    def carrying(self, word: DataWord) -> tuple[FieldContent, ...]:
        return tuple(field for field in self.fields if field.meaning.own is word)

    def relatives(self, word: DataWord) -> tuple[FieldContent, ...]:
        """Fields of another word from which it can be computed; not times.

        Heading, velocity and scans for a position. Of a type that does not carry the word, it is
        what gives it away on another topic: the velocities of `/cmd_vel`, a map, joints.
        """
        return tuple(
            field
            for field in self.fields
            if field.meaning.own is not word
            and word in field.meaning.tells
            and field.content not in TIMES | NOT_KNOWN
        )

    def hints(self, word: DataWord) -> tuple[FieldContent, ...]:
        """Fields in which it may be recognised: a person in a picture; not names of frames."""
        return tuple(
            field for field in self.fields if word in field.meaning.hints and field.content not in FRAMES
        )

    def tells(self, word: DataWord) -> bool:
        carried = self.carrying(word) or self.relatives(word) or self.hints(word)
        return word is DataWord.PRESENCE or len(carried) > 0

    @cached_property
    def fixed_arrays(self) -> frozenset[str]:
        return frozenset(field.array for field in self.fields if field.is_fixed)

    @cached_property
    def times(self) -> tuple[FieldContent, ...]:
        return tuple(field for field in self.fields if field.content in TIMES)


def describe(
    layout: Layout, own: Mapping[str, Fields] | None = None, here: Fields | None = None
) -> Description:
    """The contents of messages of `layout`.

    `own` are those of further types by name, of a policy's vocabulary; `here` those of fields of this type
    on one topic: the meaning of a bare value.
    """
    found = _fields_of(layout.root, "", own or {}, here or {}, ("", False))
    return Description(layout.type_name, tuple(found))


_Outermost = tuple[str, bool]  # the path of an array, and whether it has a fixed length


def _fields_of(
    kind: Struct, above: str, own: Mapping[str, Fields], given: Fields, array: _Outermost
) -> Iterator[FieldContent]:
    contents = {**TYPES.get(kind.name, {}), **own.get(kind.name, {}), **given}
    for name, member in kind.fields:
        within = {
            path.removeprefix(f"{name}."): content
            for path, content in contents.items()
            if path.startswith(f"{name}.")
        }
        yield from _field(member, above + name, contents.get(name), own, within, array)


def _field(
    kind: Type,
    path: str,
    all_of: Content | None,
    own: Mapping[str, Fields],
    within: Fields,
    array: _Outermost,
) -> Iterator[FieldContent]:
    inner = kind.element if isinstance(kind, Array) else kind
    if not isinstance(inner, Struct):
        yield FieldContent(path, all_of or Content.UNKNOWN, kind, *array)
        return
    if isinstance(kind, Array):
        array = array if array[0] else (path, kind.length is not None)
        path = f"{path}[*]"
    if all_of is None:
        yield from _fields_of(inner, f"{path}.", own, within, array)
        return
    for name, member in inner.fields:
        yield from _field(member, f"{path}.{name}", all_of, own, {}, array)
