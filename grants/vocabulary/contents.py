"""What a field contains, and which words it tells: its own, those it gives away, those it may show.

`tells` are exact relatives: the word can be computed from the field, as the path from a velocity.
`hints` are what a person or a program recognises in it, as a face in a picture; a rule that says a
level for the field's own word has decided on them. Times tell when a value changed. The figures are
those of the attackers' programs, in docs/spec/vocabulary.md.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Final, NamedTuple, Self

from grants.vocabulary.words import DataWord


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
    """The words of a content; `own` is the word it is shown under, if any."""

    own: DataWord | None
    tells: frozenset[DataWord]
    hints: frozenset[DataWord] = frozenset()

    @classmethod
    def of(cls, own: DataWord, *tells: DataWord) -> Self:
        """A content of `own` that tells these words as well."""
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
    """Fields by content: `fields_by(coordinate="x y", child_frame="child_frame_id")`.

    Raises:
        ValueError: there is no such content.
    """
    return {
        field: Content(content.replace("_", "-"))
        for content, fields in contents.items()
        for field in fields.split()
    }
