"""What a receiver would see of some messages: the guard of its grants (`grants.guard`) applied to them. Pure.

The messages are a preview's, kept for a minute in memory and nowhere else (`PreviewMemory`), or a minute that
nobody sent, always the same: a drive in a circle, a room around a laser, a picture of a room; for other types
a message whose numbers move. Pages say that these are made up.
"""

import hashlib
import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import is_dataclass, replace
from functools import cache, partial
from typing import Any, Final, NamedTuple, Protocol

import numpy as np

from ca.encoding import decode
from ca.errors import EncodingError
from grants.decision import Decision
from grants.errors import GrantError
from grants.filters.layout import parse
from grants.guard import Guard, needed_keys
from grants.model import Restriction, Right
from rossec.authority.keyservice.messages import frame, frame_size
from rossec.errors import KeyMessageRefused, MessageError
from rossec.participant.message_types import field_names, field_value, message_type, set_field

_NEVER: Final = 1 << 52


class Recorded(NamedTuple):
    topic: str
    type: str
    messages: tuple[tuple[float, bytes], ...]  # the last, oldest first: time and serialized bytes
    is_made_up: bool = False


class SyntheticSample(NamedTuple):
    at: float
    fields: Mapping[str, Any]


class SeenTopic(NamedTuple):
    receiver: str
    topic: str
    type: str
    sent: int  # messages, of which the receiver saw `samples`
    samples: tuple[SyntheticSample, ...]
    is_made_up: bool = False  # nobody really sent them


class Preview(Protocol):
    def recorded(self, topic: str) -> Recorded | None:
        # The last minute of a topic; None if it is not received, or nothing came.
        ...


def see(recorded: Recorded, receiver: str, restrictions: Iterable[Restriction]) -> SeenTopic:
    applied = tuple(restrictions)
    if recorded.is_made_up:  # nothing made up could fulfil a condition
        kept = [each for each in applied if each.filters or each.rate is not None or each.slot is not None]
        applied = tuple(replace(each, conditions=()) for each in kept)
    kind = message_type(recorded.type)
    decision = Decision(Right.SUBSCRIBE, recorded.topic, (), _NEVER, applied)
    # The keys of pseudonyms are the publishers' own, so here they are others.
    keys = {name: hashlib.sha256(name.encode()).digest() for name in needed_keys(applied)}
    guard = Guard(parse(kind.name, kind.definition), decision, keys)
    samples = []
    for at, message in recorded.messages:
        pieces = guard(message, int(at))
        if pieces is not None:
            samples.append(SyntheticSample(at, as_mapping(kind.deserialize(b"".join(pieces)))))
    sent = len(recorded.messages)
    return SeenTopic(receiver, recorded.topic, recorded.type, sent, tuple(samples), recorded.is_made_up)


def try_see(recorded: Recorded, receiver: str, restrictions: Iterable[Restriction]) -> SeenTopic | None:
    """As `see`; None where a real guard would refuse the connection."""
    try:
        return see(recorded, receiver, restrictions)
    except (GrantError, MessageError):
        return None


def as_mapping(message: Any) -> Mapping[str, Any]:
    return {name: _plain(field_value(message, name)) for name in field_names(message)}


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return as_mapping(value)
    return [_plain(each) for each in value] if isinstance(value, list) else value


_FRAME: Final = "map"
_SECONDS: Final = 60
_LONG: Final = 600  # seconds at one message each, where a receiver gets one in a slot of 30 or 60
_RAYS: Final = 180
_WIDTH, _HEIGHT = 160, 120
_PER_SECOND: Final = 4


def recorded(
    topic: str, type_name: str, restrictions: Iterable[Restriction] = (), preview: Preview | None = None
) -> Recorded | None:
    """Real messages where `preview` has some, else made-up ones; None: the type is not known here."""
    real = None if preview is None else preview.recorded(topic)
    if real is not None:
        return real
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
    seconds = _LONG if is_long else _SECONDS
    count = 3 if type_name in _RARE else seconds * (1 if is_long else _PER_SECOND)
    found = []
    for number in range(count):
        at = number * (seconds / count)
        message = kind.create()
        make(message, at)
        header = getattr(message, "header", None)
        if header is not None and hasattr(header, "frame_id"):
            header.frame_id = _FRAME
            header.stamp.sec, header.stamp.nanosec = int(at), int(at % 1 * 1e9)
            if hasattr(header, "seq"):
                header.seq = number
        found.append((at, bytes(kind.serialize(message))))
    return tuple(found)


def _turn(at: float) -> float:
    return 0.9 * 2 * math.pi * at / _SECONDS + math.pi / 2


def _pose(pose: Any, at: float) -> None:
    _place(pose.position, at)
    heading = _turn(at) + math.pi / 2
    pose.orientation.z, pose.orientation.w = math.sin(heading / 2), math.cos(heading / 2)


def _place(position: Any, at: float) -> None:
    angle = _turn(at)
    position.x, position.y = 1.37 + 3 * math.cos(angle), 2.71 + 3 * math.sin(angle)


def _on_earth(message: Any, at: float) -> None:
    angle = _turn(at)
    message.latitude = 47.0707 + 0.0011 * math.sin(angle)
    message.longitude = 15.4395 + 0.0016 * math.cos(angle)


def _scan(message: Any, at: float) -> None:
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
    rows, columns = np.mgrid[0:_HEIGHT, 0:_WIDTH]
    picture = np.empty((_HEIGHT, _WIDTH, 3), dtype=np.uint8)
    picture[:] = (214, 205, 190)
    picture[rows > 82] = (150, 118, 86)
    picture[(rows > 16) & (rows < 58) & (columns > 14) & (columns < 62)] = (140, 184, 224)
    picture[
        ((columns == 38) & (rows > 16) & (rows < 58)) | ((rows == 37) & (columns > 14) & (columns < 62))
    ] = (250, 250, 250)
    at_x = 104 + int(6 * math.sin(at))
    picture[(rows - 40) ** 2 + (columns - at_x) ** 2 < 90] = (196, 150, 120)
    picture[(rows > 49) & (rows < 88) & (abs(columns - at_x) < 13)] = (48, 74, 132)
    picture[(rows > 87) & (rows < 108) & (abs(columns - at_x) < 9)] = (40, 42, 54)
    message.height, message.width, message.step = _HEIGHT, _WIDTH, 3 * _WIDTH
    message.encoding, message.data = "rgb8", picture.reshape(-1)


def _anything(message: Any, at: float) -> None:
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

MEMORY_SECONDS: Final = 60
MAX_TOPICS: Final = 64
MAX_MESSAGES: Final = 600  # of one topic
MAX_TOPIC_SIZE: Final = 8 * 1024 * 1024  # bytes
MAX_SIZE: Final = 64 * 1024 * 1024


class PreviewMessage(NamedTuple):
    topic: str
    type: str
    at: float
    data: bytes


class PreviewMemory:
    """What was received within the last minute; what is older is dropped, also where nothing new comes."""

    # Publishers choose size and rate of their messages, so every number is bounded. Nothing is kept longer:
    # a console is no place to learn from what a robot has sent (console-hoard).

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._topics: dict[str, deque[PreviewMessage]] = {}
        self._sizes: dict[str, int] = {}

    def add(self, message: PreviewMessage) -> None:
        """Keep a message; a topic whose type has changed begins anew."""
        self.drop_old()
        topic, kept = message.topic, self._topics.get(message.topic)
        if kept is None and len(self._topics) >= MAX_TOPICS:
            return
        if kept and kept[-1].type != message.type:
            del self._topics[topic], self._sizes[topic]
        self._topics.setdefault(topic, deque()).append(message)
        self._sizes[topic] = self._sizes.get(topic, 0) + len(message.data)
        while len(self._topics.get(topic, ())) > MAX_MESSAGES or self._sizes.get(topic, 0) > MAX_TOPIC_SIZE:
            self._drop_oldest(topic)
        # The whole memory: the largest topic makes room, so a small one is not lost to it.
        while sum(self._sizes.values()) > MAX_SIZE:
            self._drop_oldest(max(self._sizes, key=self._sizes.__getitem__))

    def recorded(self, topic: str) -> Recorded | None:
        self.drop_old()
        kept = self._topics.get(topic)
        if not kept:
            return None
        return Recorded(topic, kept[-1].type, tuple((each.at, each.data) for each in kept))

    def drop_old(self) -> None:
        begin = self._clock() - MEMORY_SECONDS
        for topic in tuple(self._topics):
            while topic in self._topics and self._topics[topic][0].at < begin:
                self._drop_oldest(topic)

    def _drop_oldest(self, topic: str) -> None:
        self._sizes[topic] -= len(self._topics[topic].popleft().data)
        if not self._topics[topic]:
            del self._topics[topic], self._sizes[topic]


MAX_DATA: Final = 1024 * 1024  # of one message; a larger one is not drawn
MAX_FRAME: Final = MAX_DATA + 4096


# A frame is deterministic CBOR, `[topic, type, milliseconds since the epoch, data]`.
def write_preview(message: PreviewMessage) -> bytes:
    return frame([message.topic, message.type, int(message.at * 1000), message.data])


preview_size: Final = partial(frame_size, limit=MAX_FRAME)


def read_preview(body: bytes) -> PreviewMessage:
    try:
        value = decode(body, limit=MAX_FRAME)
    except EncodingError as error:
        raise KeyMessageRefused(f"a message of the preview that is malformed: {error}") from error
    match value:
        case [str(topic), str(kind), int(at), bytes(data)] if not isinstance(at, bool) and at >= 0:
            return PreviewMessage(topic, kind, at / 1000, data)
    raise KeyMessageRefused("a message of the preview that is malformed")
