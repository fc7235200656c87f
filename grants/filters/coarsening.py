"""How values are made coarse: hysteresis, rounding, rooms, and squares of pictures. Pure.

Equal values always have the same cell, and all cells have the same size. One value and an array of it give
the same bits: tests compare them.
"""

import math
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise, takewhile
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from grants.decision import Decision
from grants.errors import FilterRefused, GrantError
from grants.filters.layout import Buffer, Primitive

__all__ = ["Vector", "np"]


class _LazyNumpy:
    # Imported when the first array is treated: it takes a third of a sidecar's memory.
    def __getattr__(self, name: str) -> Any:
        found = getattr(import_module("numpy"), name)
        setattr(self, name, found)
        return found


if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Vector: TypeAlias = npt.NDArray[Any]
else:
    np = _LazyNumpy()
    Vector = Any

FieldKey: TypeAlias = tuple[object, ...]  # path of the field, and how it is rounded
Group: TypeAlias = tuple[bool, str]  # whether it is a body, and which, or which topic

_MAX_FIELDS: Final = 4096  # as many as a definition may have
_HEADER: Final = 12  # seq and stamp, before the length of frame_id


class HysteresisState:
    """The value a field with hysteresis was last rounded to."""

    __slots__ = ("value",)

    def __init__(self) -> None:
        self.value: float | None = None


# A value at a border would tell by its changes where it is, so cells have hysteresis. It is common to all
# holders of a right, and with a `body` to all topics of a publisher that show the same thing: two samples of
# one position would make the cells of both together smaller than one. There the state is kept for each frame,
# and one frame is told at a time: cells of two frames are shifted and intersect (ADR 0054).
class CommonState:
    """The hysteresis of one group; `lock` is held while a message is filtered."""

    def __init__(self, lock: AbstractContextManager[Any] | None = None) -> None:
        self.lock: Final = nullcontext() if lock is None else lock
        self._states: dict[FieldKey, HysteresisState] = {}
        self._frame: bytes | None = None
        self._until = 0.0

    def hysteresis(self, field: FieldKey) -> HysteresisState:
        if field not in self._states and len(self._states) >= _MAX_FIELDS:
            raise GrantError(f"{_MAX_FIELDS} fields with hysteresis are stored already", "restart this node")
        return self._states.setdefault(field, HysteresisState())

    def leads(self, frame: bytes, now: float, slot: int) -> bool:
        """Whether messages of `frame` are told now: that which was told first, while it comes."""
        if frame != self._frame and now < self._until:
            return False
        self._frame, self._until = frame, now + 2 * slot
        return True

    @property
    def is_fresh(self) -> bool:
        """Whether it equals a new one; a value never expires."""
        return self._frame is None and all(one.value is None for one in self._states.values())


class BodyFields:
    """The fields of one guard whose hysteresis is that of a body, frame by frame."""

    def __init__(self, common: CommonState) -> None:
        self._common = common
        self._bound: dict[FieldKey, HysteresisState] = {}

    def bind(self, field: FieldKey) -> HysteresisState:
        """The state that the filter of a field uses.

        It is found by the field's own name: `x` of a pose and of an odometry are the same. A second
        one of that name in a message is another point.
        """
        names = list(takewhile(lambda part: isinstance(part, str), field[1:]))
        how = field[1 + len(names) :]
        name = "" if "/" in str(names[-1]) else names[-2]  # a whole position is told by its plan
        key = (field[0], name, *how)
        return self._bound.setdefault(field if key in self._bound else key, HysteresisState())

    def load(self, frame: bytes) -> None:
        for key, state in self._bound.items():
            state.value = self._common.hysteresis((frame, *key)).value

    def store(self, frame: bytes) -> None:
        for key, state in self._bound.items():
            self._common.hysteresis((frame, *key)).value = state.value


def group_of(decision: Decision) -> Group:
    """What the hysteresis of a decision is common to."""
    bodies = {each.body for each in decision.restrictions if each.body is not None}
    if len(bodies) > 1:
        raise GrantError(
            f"the grants for {decision.name} name {len(bodies)} bodies: " + ", ".join(sorted(bodies)),
            "what is one body has one name in the policy",
        )
    return (True, bodies.pop()) if bodies else (False, decision.name)


def frame_reader(*, has_header: bool) -> Callable[[Any], bytes]:
    """A function that reads the frame of a message; empty if its type begins with no header."""

    def frame(message: Any) -> bytes:
        end = _HEADER + 4
        size = int.from_bytes(message[_HEADER:end], "little")
        return bytes(message[end : end + size])

    return frame if has_header else lambda _: b""


Rounding: TypeAlias = tuple[Callable[..., Any], Callable[[Vector], Vector]]

_SECOND: Final = 10**9
_FLOAT_MAX: Final = {"f": float.fromhex("0x1.fffffep+127"), "d": sys.float_info.max}


# `floor(x / step + 1/2) * step`: unlike "half to even" all cells have the same size. Values stay in their
# type's range (the last multiple in it), NaN and infinities pass.
def round_floats(kind: Primitive, step: float) -> Rounding:
    step = float(step)
    largest = _FLOAT_MAX[kind.code]
    cells = largest / step
    last = min(math.floor(cells) * step, largest) if math.isfinite(cells) else largest
    # Below this the plain formula is correct (NaN is never below): the cell is within 2^53 of
    # zero, where half a cell is still representable, and its value in the type's range.
    plain = min(cells - 1, 2.0**52)
    square = max(plain, 0.0) ** 2

    def scalar(value: float) -> float:
        cell = value / step
        if -plain < cell < plain:
            return (cell + 0.5) // 1.0 * step
        if not math.isfinite(cell):  # NaN, infinite, or a step far below the value's precision
            return value
        return min(max(math.floor(cell + 0.5) * step, -last), last)

    # Arrays without dimensions: numpy takes them faster than Python's floats.
    width, half = np.array(step), np.array(0.5)

    @np.errstate(all="ignore")
    def vector(values: Vector) -> Vector:
        cells = values.astype(np.float64)
        cells /= width
        # The norm is an upper bound of every cell, at a tenth of the price of a maximum.
        if np.vdot(cells, cells) < square:
            cells += half
            np.floor(cells, cells)
            cells *= width
            return cells
        rounded = np.clip(np.floor(cells + half) * width, -last, last)
        return np.where(np.isfinite(cells), rounded, values.astype(np.float64))

    return scalar, vector


def round_integers(kind: Primitive, step: float) -> Rounding:
    bits = 8 * kind.size
    low, high = (0, (1 << bits) - 1) if kind.code.isupper() else (-(1 << bits - 1), (1 << bits - 1) - 1)
    if not float(step).is_integer() or step > high:
        raise FilterRefused(f"a step for {kind.name} must be whole and at most {high}")
    whole = int(step)
    scalar = _exact(whole, low, high)
    first, last = -(-low // whole) * whole, high // whole * whole

    def small(values: Vector) -> Vector:
        wide = values.astype(np.int64)
        return np.clip((2 * wide + whole) // (2 * whole) * whole, first, last)

    def large(values: Vector) -> Vector:  # 64 bits leave numpy no headroom
        rounded = [scalar(value) for value in values.reshape(-1).tolist()]
        return np.array(rounded, values.dtype).reshape(values.shape)

    return scalar, small if kind.size < 8 else large


def round_times(kind: Primitive, step: float) -> Rounding:
    """For time and duration, as pairs (seconds, nanoseconds); `step` in seconds."""
    ticks = round(step * _SECOND) if step < 1 << 31 else 0
    if ticks < 1:
        raise FilterRefused(f"a step for {kind.name} must lie between 1e-9 and 2^31 seconds")
    low, high = (0, (1 << 32) - 1) if kind.name == "time" else (-(1 << 31), (1 << 31) - 1)
    exact = _exact(ticks, low * _SECOND, high * _SECOND + _SECOND - 1)

    def scalar(seconds: int, nanoseconds: int) -> tuple[int, int]:
        return divmod(exact(seconds * _SECOND + nanoseconds), _SECOND)

    def vector(values: Vector) -> Vector:
        pairs = [scalar(*pair) for pair in values.reshape(-1, 2).tolist()]
        return np.array(pairs, values.dtype).reshape(values.shape)

    return scalar, vector


def _exact(step: int, low: int, high: int) -> Callable[[int], int]:
    first, last = -(-low // step) * step, high // step * step

    def scalar(value: int) -> int:
        return min(max((2 * value + step) // (2 * step) * step, first), last)

    return scalar


def with_hysteresis(
    scalar: Callable[[float], float], step: float, hysteresis: float
) -> Callable[[HysteresisState], Callable[[float], float]]:
    # Stays in its cell until the value is `hysteresis` beyond the border. A function from state to `scalar`.
    reach = step / 2 + hysteresis

    def bind(state: HysteresisState) -> Callable[[float], float]:
        def scalar_with_hysteresis(value: float) -> float:
            previous = state.value
            # With NaN the comparison is false; NaN and infinities pass and are not stored.
            if previous is not None and abs(value - previous) <= reach:
                return previous
            rounded = scalar(value)
            if math.isfinite(rounded):
                state.value = rounded
            return rounded

        return scalar_with_hysteresis

    return bind


Point: TypeAlias = tuple[float, float]
Place: TypeAlias = tuple[float, ...]  # the values of a message with a position

# A position becomes the point of the room it is in. A plan is a text for each room: the corners of a
# polygon, or two opposite corners of a rectangle. A position in no room has no value (NaN): zero, or the
# nearest room, would name a place where it is not. docs/spec/grant.md, section 6.4.
MAX_ROOMS: Final = 64
MAX_CORNERS: Final = 512  # of all rooms
MAX_TEXT: Final = 1000  # characters of one room
_NAME: Final = re.compile(r"[a-z][a-z0-9_-]{0,31}", re.ASCII)
_NUMBER: Final = r"-?(?:0|[1-9][0-9]{0,5})(?:\.[0-9]{1,3})?"
_CORNERS: Final = re.compile(rf"{_NUMBER} {_NUMBER}(?:, ?{_NUMBER} {_NUMBER})+", re.ASCII)
_EXAMPLE: Final = 'for example {rooms: {kitchen: "0 0, 4 3", hall: "4 0, 9 0, 9 6, 4 3"}}'


@dataclass(frozen=True)
class Room:
    """A polygon, by the rule of even crossings, and the point that stands for it."""

    name: str
    corners: tuple[Point, ...]
    point: Point

    @property
    def edges(self) -> Iterable[tuple[Point, Point]]:
        return pairwise((*self.corners, self.corners[0]))

    def covers(self, x: float, y: float) -> bool:
        """Whether the point is in the room; of two rooms with a common wall it is in one."""
        within = False
        for (x0, y0), (x1, y1) in self.edges:
            if (y0 <= y) != (y1 <= y) and x < x0 + (y - y0) * (x1 - x0) / (y1 - y0):
                within = not within
        return within

    def is_within(self, reach: float, x: float, y: float) -> bool:
        return self.covers(x, y) or any(_distance(edge, x, y) <= reach for edge in self.edges)


def _distance(edge: tuple[Point, Point], x: float, y: float) -> float:
    (x0, y0), (x1, y1) = edge
    dx, dy = x1 - x0, y1 - y0
    length = dx * dx + dy * dy
    along = min(max(((x - x0) * dx + (y - y0) * dy) / length, 0.0), 1.0) if length else 0.0
    return math.hypot(x - x0 - along * dx, y - y0 - along * dy)


def read_plan(texts: Mapping[str, object]) -> tuple[Room, ...]:
    """The rooms of a plan, in the order of their names."""
    if not 0 < len(texts) <= MAX_ROOMS:
        raise FilterRefused(f"rooms needs 1 to {MAX_ROOMS} rooms", _EXAMPLE)
    rooms = tuple(_room(name, texts[name]) for name in sorted(texts))
    if sum(len(room.corners) for room in rooms) > MAX_CORNERS:
        raise FilterRefused(f"rooms with more than {MAX_CORNERS} corners", "draw them simpler")
    return rooms


def _room(name: str, text: object) -> Room:
    if _NAME.fullmatch(name) is None:
        raise FilterRefused(f"not the name of a room: {name[:40]!r}", _EXAMPLE)
    if not isinstance(text, str) or len(text) > MAX_TEXT or _CORNERS.fullmatch(text) is None:
        raise FilterRefused(f"room {name} has no corners: {str(text)[:40]!r}", _EXAMPLE)
    pairs = (pair.split() for pair in text.split(","))
    corners = tuple((float(x), float(y)) for x, y in pairs)
    if len(corners) == 2:  # opposite corners
        (x0, y0), (x1, y1) = corners
        corners = ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
    return Room(name, corners, _middle(name, corners))


def _middle(name: str, corners: tuple[Point, ...]) -> Point:
    flat = Room(name, corners, (0.0, 0.0))
    best, point = 0.0, (0.0, 0.0)
    for low, high in pairwise(sorted({y for _, y in corners})):
        y = (low + high) / 2
        crossed = sorted(
            x0 + (y - y0) * (x1 - x0) / (y1 - y0)
            for (x0, y0), (x1, y1) in flat.edges
            if (y0 <= y) != (y1 <= y)
        )
        for left, right in zip(crossed[::2], crossed[1::2], strict=True):
            if (right - left) * (high - low) > best:
                best, point = (right - left) * (high - low), ((left + right) / 2, y)
    if best <= 0:
        raise FilterRefused(f"room {name} has no area", _EXAMPLE)
    return point


def snapping(
    rooms: tuple[Room, ...], reach: float | None
) -> Callable[[HysteresisState], Callable[..., Place]]:
    # With `reach`, the hysteresis, a state holds the number of the room a position was last in: a position
    # at a door would tell by the changes exactly where it is.

    def bind(state: HysteresisState) -> Callable[..., Place]:
        def snap(x: float, y: float, *rest: float) -> Place:
            last = state.value
            if reach is None or last is None or not rooms[int(last)].is_within(reach, x, y):
                found = (number for number, room in enumerate(rooms) if room.covers(x, y))
                last = state.value = next(found, None)
            if last is None:
                return (math.nan,) * (2 + len(rest))
            return *rooms[int(last)].point, *(0.0 for _ in rest)

        return snap

    return bind


def snap_rows(snap: Callable[..., Place], width: int) -> Callable[[Vector], Vector]:
    def vector(values: Vector) -> Vector:
        found = [snap(*row) for row in values.reshape(-1, width).tolist()]
        return np.array(found, values.dtype).reshape(values.shape)

    return vector


# Pixelation: every square of a picture shows the colour of its first pixel, or its mean in grey. The first
# pixel moves with what moves: ten pictures of a face gave ten samples of it. A mean alone tells more than
# one pixel does; few levels of grey are what hides a face (measured: `python -m bench privacy`). So means
# come with `levels`, and only in bytes whose meaning is known. Squares of a fixed number of pixels hide a
# face in a small picture and show it in a large one, so they can be given by how many there are across:
# whatever sizes a message claims, no more leave it in either direction. They are aligned with the picture's
# corner, also in a region, so a moving region reveals no more than its squares: a grey is the mean of its
# whole square. Padding between the rows is zeroed. An encoding that is not in the table is refused: its
# pixel size is unknown, and a Bayer pattern or YUV 4:2:2 shares colours between pixels.
Region: TypeAlias = tuple[int, ...]  # x, y, width, height
_Pixels: TypeAlias = Vector

MAX_SIDE: Final = 65535
_IN_32_BITS: Final = ((1 << 32) - 1) // 255  # so many bytes can be summed

# The fields of a sensor_msgs/Image that are read with its data.
SIBLINGS: Final = (("height", "uint32"), ("width", "uint32"), ("encoding", "string"), ("step", "uint32"))

# Bytes of a pixel: sensor_msgs/image_encodings.h.
_COLOURS: Final = {"rgb": 3, "bgr": 3, "rgba": 4, "bgra": 4, "mono": 1}
_NAMED: Final = {f"{name}{8 * size}": size * count for name, count in _COLOURS.items() for size in (1, 2)}
_DEPTHS: Final = {"8U": 1, "8S": 1, "16U": 2, "16S": 2, "32S": 4, "32F": 4, "64F": 8}
_GENERIC: Final = {
    f"{depth}C{channels}": size * channels for depth, size in _DEPTHS.items() for channels in range(1, 5)
}
PIXEL_SIZES: Final = _NAMED | _GENERIC
# Channels of a byte each: their number, and how many of them are colours. The rest is opacity.
_CHANNELS: Final = {
    **dict.fromkeys(("mono8", "8UC1"), (1, 1)),
    **dict.fromkeys(("rgb8", "bgr8", "8UC3"), (3, 3)),
    **dict.fromkeys(("rgba8", "bgra8"), (4, 3)),
}


def pixelation(
    block: int, region: Region | None, levels: int | None = None, across: int | None = None
) -> Callable[[Buffer, int, int, str, int], tuple[Buffer, int]]:
    # The function from the data, height, width, encoding and step of a picture to its new data. Squares
    # have a side of `block` pixels; with `across` a larger one if more than so many would fit along the
    # longer side. It raises ValueError for an unknown encoding (with `levels`: also for one of more than a
    # byte a channel), or when the data is not `height` rows.

    def rewrite(content: Buffer, height: int, width: int, encoding: str, step: int) -> tuple[Buffer, int]:
        size = PIXEL_SIZES.get(encoding) if levels is None else _CHANNELS.get(encoding, (None,))[0]
        if size is None or width * size > step or height * step != len(content):
            raise ValueError
        if height == 0 or width == 0:
            return bytes(len(content)), len(content)
        x, y, wide, high = region or (0, 0, width, height)
        rows = np.frombuffer(content, np.uint8).reshape(height, step)
        pixels = np.ascontiguousarray(rows[:, : width * size]).view(f"V{size}")
        area = (slice(y, y + high), slice(x, x + wide))
        side = block if across is None else max(block, -(-max(height, width) // across))
        if levels is None:
            result = _squares(pixels[::side, ::side], side, pixels.shape)
        else:
            means = _means(pixels, side, levels, _CHANNELS[encoding])
            result = _squares(means, side, pixels.shape)
        if region is not None:
            whole = pixels.copy()
            whole[area] = result[area]
            result = whole
        padded = np.zeros((height, step), np.uint8)
        padded[:, : width * size] = result.view(np.uint8).reshape(height, -1)
        return padded.tobytes(), len(content)

    return rewrite


def _squares(found: _Pixels, block: int, shape: tuple[int, ...]) -> _Pixels:
    height, width = shape
    across = np.repeat(found, min(block, width), axis=1)[:, :width]
    # Few rows are repeated along the row first, then whole rows are copied.
    return np.ascontiguousarray(np.repeat(across, min(block, height), axis=0)[:height])


def _means(pixels: _Pixels, block: int, levels: int, channels: tuple[int, int]) -> _Pixels:
    # The pixel of every square: opaque, and the mean of its colours as one of so many greys.
    every, colours = channels
    height, width = pixels.shape
    values = pixels.view(np.uint8).reshape(height, width * every)
    # Rows first, which lie one after the other. The rest is little.
    wide = np.uint32 if block <= _IN_32_BITS else np.uint64
    rows = np.add.reduceat(values, np.arange(0, height, block), axis=0, dtype=wide)
    sums = rows.reshape(-1, width, every)[..., :colours].sum(axis=2, dtype=np.uint64)
    sums = np.add.reduceat(sums, np.arange(0, width, block), axis=1)
    counts = np.outer(_lengths(height, block), _lengths(width, block)) * np.uint64(256 * colours)
    greys = sums * np.uint64(levels) // counts * np.uint64(255) // np.uint64(levels - 1)
    found = np.full((*greys.shape, every), 255, np.uint8)
    found[..., :colours] = greys[..., np.newaxis]
    return found.reshape(greys.shape[0], -1).view(f"V{every}")


def _lengths(size: int, block: int) -> Vector:
    starts = np.arange(0, size, block)
    return np.minimum(block, size - starts).astype(np.uint64)
