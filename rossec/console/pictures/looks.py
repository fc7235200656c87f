"""What a topic looks like to each of its receivers: one picture for each way to see it. Pure.

A type has a picture (a place, a laser scan from above, a camera picture as PNG in the page, a number over the
last minute as a line) or its fields as text, with those struck that a receiver does not get. Rounded
distances show as rings, removed ones as an empty circle, and a rounded number as a staircase.
"""

import base64
import io
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from PIL import Image

from grants.model import FilterRule
from grants.vocabulary.assess import filters_of
from rossec.console import words
from rossec.console.matrix import SEEING, Cell, TopicAccess
from rossec.console.pictures import place
from rossec.console.pictures.svg import Point, SvgElement, circle, drawing, ground, label, path
from rossec.console.samples import Recorded, SeenTopic, try_see
from rossec.peer_limits import printable

IMAGE_TYPE: Final = "sensor_msgs/Image"
IMAGE_WIDTH: Final = 320.0
_MAX_SIDE: Final = 8192
_MAX_PNG: Final = 9_000  # bytes: a page has several, and at most 100 kB
_SIDES: Final = (240, 160, 120, 80, 40)
# Encoding of sensor_msgs/image_encodings: channels, and their order as red, green, blue.
_ENCODINGS: Final = {
    "mono8": (1, None),
    "8UC1": (1, None),
    "rgb8": (3, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "8UC3": (3, (2, 1, 0)),
    "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)),
}


def draw_image(seen: SeenTopic) -> SvgElement | None:
    if not seen.samples:
        return None
    fields = seen.samples[-1].fields
    height, width, row = int(fields["height"]), int(fields["width"]), int(fields["step"])
    channels, order = _ENCODINGS.get(str(fields["encoding"]), (0, None))
    data = np.asarray(fields["data"], dtype=np.uint8)
    # A publisher chooses all of these: an encoding that is not in the table is not drawn, nor one whose bytes
    # do not have the size that its header says.
    fits = 0 < width <= _MAX_SIDE and 0 < height <= 4 * width and row >= width * channels > 0
    if not fits or data.size != height * row:
        return None
    pixels = data.reshape(height, row)[:, : width * channels]
    if order is not None:
        pixels = pixels.reshape(height, width, channels)[:, :, list(order)]
    picture = _png(Image.fromarray(pixels.copy()))
    high = IMAGE_WIDTH * height / width
    shown = SvgElement.picture(
        base64.b64encode(picture).decode(), width=IMAGE_WIDTH, height=high, class_="photo"
    )
    return drawing(IMAGE_WIDTH, high, f"The picture that {seen.receiver} sees", shown, class_="camera")


def _png(picture: Image.Image) -> bytes:
    data = b""
    for side in _SIDES:
        small = picture.copy()
        small.thumbnail((side, side), Image.Resampling.BOX)
        out = io.BytesIO()
        small.save(out, "PNG", optimize=True)
        data = out.getvalue()
        if len(data) <= _MAX_PNG:
            break
    return data


SCAN_TYPE: Final = "sensor_msgs/LaserScan"
SCAN_SIZE: Final = 300.0
_MIDDLE: Final = SCAN_SIZE / 2
_REACH: Final = SCAN_SIZE / 2 - 14
_RINGS: Final = 3
_MAX_RAYS: Final = 360
_MAX_ANGLE: Final = 1e3
_FAR: Final = 1e6  # metres: what is farther is no wall


def reach_of(seen: SeenTopic) -> float:
    return max((distance for _, distance in _rays(seen)), default=0.0)


def draw_scan(seen: SeenTopic, reach: float) -> SvgElement | None:
    """The last scan, with `reach` metres from the middle to the edge; None without a scan."""
    if not seen.samples:
        return None
    scale = _REACH / reach if reach > 0 else 0.0
    radii = [_REACH * number / _RINGS for number in range(1, _RINGS + 1)]
    rings = [circle((_MIDDLE, _MIDDLE), radius, "grid ring") for radius in radii]
    hits = []
    for angle, distance in _rays(seen):
        far = min(distance * scale, _REACH)
        hits.append((_MIDDLE + far * math.cos(angle), _MIDDLE - far * math.sin(angle)))
    dots = [circle(hit, 1.6, "hit") for hit in hits]
    text = [label(_MIDDLE, SCAN_SIZE - 2, f"{reach:.3g} m", "ruler-text", "middle")] if scale else []
    here = circle((_MIDDLE, _MIDDLE), 4.5, "here")
    outline = [path([*hits, hits[0]], "outline")] if len(hits) > 2 else []
    said = f"{len(hits)} rays that {seen.receiver} sees, from above"
    return drawing(SCAN_SIZE, SCAN_SIZE, said, *rings, *outline, *dots, here, *text, class_="laser")


def _rays(seen: SeenTopic) -> list[Point]:
    if not seen.samples:
        return []
    fields = seen.samples[-1].fields
    start, step = float(fields["angle_min"]), float(fields["angle_increment"])
    if not (abs(start) < _MAX_ANGLE and abs(step) < _MAX_ANGLE):  # also if one is no number
        return []
    every = max(1, math.ceil(len(fields["ranges"]) / _MAX_RAYS))
    return [
        (start + number * step, float(distance))
        for number, distance in enumerate(fields["ranges"])
        if number % every == 0 and 0 < float(distance) < _FAR
    ]


SERIES_WIDTH, SERIES_HEIGHT = 300.0, 100.0
_EDGE: Final = 10.0
_MAX_POINTS: Final = 300
_LARGE: Final = 1e300  # a difference of two is still a number
_NOT_SHOWN: Final = ("seq", "stamp", "sec", "nanosec")


class Span(NamedTuple):
    first: float
    last: float
    low: float
    high: float


def field_of(seen: SeenTopic) -> str:
    if not seen.samples:
        return ""
    last = dict(_numbers(seen.samples[-1].fields, ""))
    first = dict(_numbers(seen.samples[0].fields, ""))
    changing = [path_ for path_, value in last.items() if first.get(path_) != value]
    return next(iter([*changing, *last]), "")


def span_of(seen: Iterable[SeenTopic], field: str) -> Span | None:
    points = [point for each in seen for point in _points(each, field)]
    if not points:
        return None
    times, values = [at for at, _ in points], [value for _, value in points]
    return Span(min(times), max(times), min(values), max(values))


def draw_series(seen: SeenTopic, field: str, span: Span) -> SvgElement | None:
    points = _points(seen, field)
    if not points:
        return None
    every = max(1, math.ceil(len(points) / _MAX_POINTS))
    long, high = span.last - span.first or 1.0, span.high - span.low
    drawn = []
    for at, value in points[::every]:
        level = (value - span.low) / high if high else 0.5
        x = _EDGE + (SERIES_WIDTH - 2 * _EDGE) * (at - span.first) / long
        drawn.append((x, SERIES_HEIGHT - _EDGE - 12 - (SERIES_HEIGHT - 2 * _EDGE - 24) * level))
    parts = [
        ground(SERIES_WIDTH, SERIES_HEIGHT),
        path([drawn[0], *drawn], "track shade5"),
        circle(drawn[-1], 4.0, "here"),
        label(_EDGE, _EDGE + 5, f"{span.high:.4g}", "ruler-text"),
        label(_EDGE, SERIES_HEIGHT - 5, f"{span.low:.4g}", "ruler-text"),
    ]
    values = {value for _, value in points}
    said = f"{field}: {len(values)} different values that {seen.receiver} sees"
    return drawing(SERIES_WIDTH, SERIES_HEIGHT, said, *parts, class_="series")


def _points(seen: SeenTopic, field: str) -> list[Point]:
    found = [(each.at, dict(_numbers(each.fields, "")).get(field)) for each in seen.samples]
    return [(at, value) for at, value in found if value is not None]


def _numbers(fields: Mapping[str, Any], above: str) -> Iterator[tuple[str, float]]:
    for name, value in fields.items():
        if name in _NOT_SHOWN:
            continue
        if isinstance(value, Mapping):
            yield from _numbers(value, f"{above}{name}.")
        elif type(value) in (int, float) and abs(value) < _LARGE:
            yield f"{above}{name}", float(value)


MAX_LOOKS: Final = 6
MAX_FIELDS: Final = 24
MAX_MESSAGES: Final = 600
_LAST: Final = 3
_MAX_VALUE: Final = 60
_REMOVING: Final = ("clear", "drop", "zero")


class FieldLine(NamedTuple):
    path: str
    value: str
    removed: bool


class Look(NamedTuple):
    receivers: tuple[str, ...]
    heading: str
    caption: str
    access: TopicAccess
    picture: SvgElement | None
    fields: tuple[FieldLine, ...]


class Comparison(NamedTuple):
    topic: str
    type: str
    looks: tuple[Look, ...]
    more: int  # ways to see it that are not shown
    is_made_up: bool


def compare(recorded: Recorded, cells: Iterable[Cell]) -> Comparison:
    """The different ways in which the receivers of `cells` see `recorded`, the widest first."""
    # All receivers with the same restrictions share a picture.
    ways: dict[Any, list[Cell]] = {}
    for cell in cells:
        if cell.access in SEEING:
            ways.setdefault(cell.restrictions, []).append(cell)
    groups = sorted(ways.values(), key=lambda group: (bool(group[0].restrictions), group[0]))
    shown = groups[:MAX_LOOKS]
    newest = _LAST if recorded.type in (SCAN_TYPE, IMAGE_TYPE) else MAX_MESSAGES  # of these the last is drawn
    recorded = recorded._replace(messages=recorded.messages[-newest:])
    exact = try_see(recorded, "", ())
    if exact is None:  # the type of the messages is not known here
        return Comparison(recorded.topic, recorded.type, (), 0, recorded.is_made_up)
    seen = [try_see(recorded, group[0].receiver, group[0].restrictions) for group in shown]
    cells = [group[0] for group in shown]
    drawer = _Drawer.of(exact, [each for each in seen if each], cells, minutes(recorded))
    looks = tuple(_look(drawer, group, each) for group, each in zip(shown, seen, strict=True))
    return Comparison(recorded.topic, recorded.type, looks, len(groups) - len(shown), recorded.is_made_up)


class _Drawer(NamedTuple):
    # What all pictures of one comparison share, or it would lie.
    frame: place.PlaceFrame | None
    reach: float
    field: str
    span: Span | None
    during: str

    @classmethod
    def of(cls, exact: SeenTopic, seen: list[SeenTopic], cells: Iterable[Cell], long: int) -> "_Drawer":
        restrictions = [each for cell in cells for each in cell.restrictions]
        frame = place.frame_of([exact], restrictions) if place.has_place(exact.type) else None
        reach = max(map(reach_of, [exact, *seen])) if exact.type == SCAN_TYPE else 0.0
        drawn = frame is not None or exact.type in (SCAN_TYPE, IMAGE_TYPE)
        field = "" if drawn else field_of(exact)
        during = "in this minute" if long == 1 else f"in these {long} minutes"
        return cls(frame, reach, field, span_of([exact, *seen], field), during)

    def picture(self, cell: Cell, seen: SeenTopic) -> tuple[str, str, SvgElement | None]:
        messages = words.count(len(seen.samples), "message")
        if self.frame is not None:
            cells = place.cells_of(cell.restrictions, self.frame.origin)
            picture = place.draw(seen, self.frame, max(cells, default=None))
            if picture is None:
                return "does not see the place", f"{messages} {self.during}", None
            said, what = ("sees which square", "square") if cells else ("sees the exact place", "place")
            return said, f"{words.count(place.places(seen), what)} {self.during}", picture
        if seen.type == SCAN_TYPE:
            return "sees what the laser meets", "", draw_scan(seen, self.reach)
        if seen.type == IMAGE_TYPE:
            heading = "sees this of the picture" if cell.restrictions else "sees the picture"
            return heading, "", draw_image(seen)
        if self.field and self.span is not None:
            name = words.field_name(self.field, seen.type)
            return f"sees the {name}", messages, draw_series(seen, self.field, self.span)
        return "sees these fields", messages, None


def minutes(recorded: Recorded) -> int:
    times = [at for at, _ in recorded.messages]
    return max(1, math.ceil((max(times) - min(times)) / 60)) if times else 1


def _look(drawer: _Drawer, group: Sequence[Cell], seen: SeenTopic | None) -> Look:
    cell = group[0]
    receivers = tuple(each.receiver for each in group)
    if seen is None:
        said = "gets nothing: the grant does not fit these messages"
        return Look(receivers, said, cell.words, cell.access, None, ())
    if not seen.samples:
        caption = f"none of {words.count(seen.sent, 'message')} passed: {cell.words}"
        return Look(receivers, "gets none of these", caption, cell.access, None, ())
    heading, detail, picture = drawer.picture(cell, seen)
    caption = ": ".join(filter(None, (detail, cell.words)))
    lines: list[FieldLine] = []
    if picture is None:
        rules = [rule for each in cell.restrictions for rule in each.filters]
        _walk(seen.samples[-1].fields, "", rules, lines)
    return Look(receivers, heading, printable(caption, 400), cell.access, picture, tuple(lines[:MAX_FIELDS]))


def _walk(fields: Mapping[str, Any], above: str, rules: list[FilterRule], found: list[FieldLine]) -> None:
    for name, value in fields.items():
        path = f"{above}{name}"
        if isinstance(value, Mapping):
            _walk(value, f"{path}.", rules, found)
            continue
        removed = any(rule.operator in _REMOVING for rule in filters_of(rules, path))
        found.append(FieldLine(path, "" if removed else _text(value), removed))


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if hasattr(value, "__len__") and not isinstance(value, str):
        return f"{len(value)} values"
    return printable(value, _MAX_VALUE)
