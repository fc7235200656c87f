"""Where something was: a track for one who sees the place, squares for one who sees cells. Pure.

All pictures of one topic have one frame, or a comparison of them would lie.
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any, Final, NamedTuple, TypeAlias

from grants.model import FilterRule, Restriction
from rossec.console.pictures.svg import Point, SvgElement, box, circle, drawing, ground, label, path
from rossec.console.samples import SeenTopic, SyntheticSample

WIDTH, HEIGHT = 300.0, 250.0
_SHADES: Final = 5
_EARTH: Final = 111_320.0  # metres of a degree of latitude
_MARGIN: Final = 1.2  # metres around what was seen, at least
_MAX_CELLS: Final = 400
_FAR: Final = 1e8  # metres, farther than anything on earth
_MAX_POINTS: Final = 300

# The field with the place, by message type; `_ON_EARTH` has latitude and longitude instead.
_POSITION: Final[Mapping[str, str]] = {
    "geometry_msgs/Pose": "position",
    "geometry_msgs/PoseStamped": "pose.position",
    "geometry_msgs/PoseWithCovarianceStamped": "pose.pose.position",
    "geometry_msgs/PointStamped": "point",
    "geometry_msgs/TransformStamped": "transform.translation",
    "nav_msgs/Odometry": "pose.pose.position",
}
_ON_EARTH: Final = "sensor_msgs/NavSatFix"

Extent: TypeAlias = tuple[float, float]


class PlaceFrame(NamedTuple):
    x: float
    y: float
    width: float
    origin: Point | None = None

    @property
    def scale(self) -> float:
        return WIDTH / self.width

    def at(self, point: Point) -> Point:
        x = WIDTH / 2 + (point[0] - self.x) * self.scale
        return _inside((x, HEIGHT / 2 - (point[1] - self.y) * self.scale))


def has_place(type_name: str) -> bool:
    return type_name in _POSITION or type_name == _ON_EARTH


def frame_of(seen: Iterable[SeenTopic], restrictions: Iterable[Restriction] = ()) -> PlaceFrame | None:
    """The frame for all of `seen`, with whole cells of `restrictions`; None: there is no place."""
    given = list(seen)
    origin = next(filter(None, (_origin(each) for each in given)), None)
    points = [point for each in given for point in _points(each, origin)]
    if not points:
        return None
    edge = max([_MARGIN, *(side for each in cells_of(restrictions, origin) for side in each)])
    low_x, high_x = min(x for x, _ in points) - edge, max(x for x, _ in points) + edge
    low_y, high_y = min(y for _, y in points) - edge, max(y for _, y in points) + edge
    width = max(high_x - low_x, (high_y - low_y) * WIDTH / HEIGHT)
    return PlaceFrame((low_x + high_x) / 2, (low_y + high_y) / 2, width, origin)


def cells_of(restrictions: Iterable[Restriction], origin: Point | None = None) -> list[Extent]:
    return [cell for each in restrictions if (cell := _cell(each, origin)) is not None]


def draw(seen: SeenTopic, frame: PlaceFrame, cell: Extent | None) -> SvgElement | None:
    """One receiver's picture: squares if it gets cells, else the track; None: it gets no place."""
    points = _points(seen, frame.origin)
    if not points:
        return None
    # The paper: lines between the cells, or at round numbers of metres.
    metres = _round_length(frame.width / 11)
    wide, high = cell or (metres, metres)
    reach = frame.width * HEIGHT / WIDTH / 2
    lines = [ground(WIDTH, HEIGHT)]
    for x in _steps(frame.x - frame.width / 2, frame.x + frame.width / 2, wide, cell is not None):
        across = frame.at((x, 0.0))[0]
        lines.append(SvgElement("line", x1=across, y1=0.0, x2=across, y2=HEIGHT, class_="grid"))
    for y in _steps(frame.y - reach, frame.y + reach, high, cell is not None):
        up = frame.at((0.0, y))[1]
        lines.append(SvgElement("line", x1=0.0, y1=up, x2=WIDTH, y2=up, class_="grid"))
    # The ruler, in the corner.
    length = _round_length(frame.width / 4)
    left, right, y = WIDTH - 14 - length * frame.scale, WIDTH - 14, HEIGHT - 12
    text = f"{length:g} m" if length < 1000 else f"{length / 1000:g} km"
    mark = path([(left, y - 5), (left, y), (right, y), (right, y - 5)], "ruler")
    ruler = SvgElement("g", mark, label((left + right) / 2, y - 6, text, "ruler-text", "middle"))
    if cell is None:
        drawn, said = _track(seen, points, frame), f"The track that {seen.receiver} sees"
    else:
        drawn = _squares(points, frame, cell)
        said = f"The {distinct(points)} squares that {seen.receiver} sees"
    return drawing(WIDTH, HEIGHT, said, SvgElement("g", *lines), ruler, *drawn, class_="place")


def distinct(points: Sequence[Point]) -> int:
    return len({(round(x, 3), round(y, 3)) for x, y in points})


def places(seen: SeenTopic) -> int:
    return distinct(_points(seen, _origin(seen)))


def _cell(restriction: Restriction, origin: Point | None) -> Extent | None:
    steps = {rule.path: _step(rule) for rule in restriction.filters}
    if restriction.type == _ON_EARTH:
        north, east = steps.get("latitude"), steps.get("longitude")
        if origin is None or (north is None and east is None):
            return None
        shrink = math.cos(math.radians(origin[0]))
        return ((east or north or 0) * _EARTH * shrink, (north or east or 0) * _EARTH)
    field = _POSITION.get(restriction.type or "")
    if field is None:
        return None
    both = steps.get(field)
    x, y = steps.get(f"{field}.x", both), steps.get(f"{field}.y", both)
    return (x or y or 0.0, y or x or 0.0) if x or y else None


def _step(rule: FilterRule) -> float | None:
    step = dict(rule.parameters).get("step")
    return float(step) if rule.operator == "round" and isinstance(step, int | float) else None


def _read(sample: SyntheticSample, path_: str) -> Any:
    value: Any = sample.fields
    for step in path_.split("."):
        value = value[step]
    return value


def _origin(seen: SeenTopic) -> Point | None:
    if seen.type != _ON_EARTH:
        return None
    for sample in seen.samples:
        at = (float(sample.fields["latitude"]), float(sample.fields["longitude"]))
        if abs(at[0]) < 90 and abs(at[1]) <= 360 and any(at):
            return at
    return None


def _points(seen: SeenTopic, origin: Point | None) -> list[Point]:
    if seen.type == _ON_EARTH:
        if origin is None:
            return []
        # In metres around the first one: equirectangular, exact enough for a minute.
        shrink = math.cos(math.radians(origin[0])) * _EARTH
        degrees = [(float(each.fields["longitude"]), float(each.fields["latitude"])) for each in seen.samples]
        found = [((east - origin[1]) * shrink, (north - origin[0]) * _EARTH) for east, north in degrees]
        return [point for point in found if _is_near(point)]
    field = _POSITION.get(seen.type)
    if field is None:
        return []
    read = [_read(each, field) for each in seen.samples]
    found = [(float(each["x"]), float(each["y"])) for each in read]
    found = [point for point in found if _is_near(point)]
    return found if any(map(any, found)) else []


def _is_near(point: Point) -> bool:
    # Whether it can be drawn: not a number, and infinitely far, are neither.
    return all(abs(value) < _FAR for value in point)


def _steps(low: float, high: float, step: float, between: bool) -> list[float]:
    offset = 0.5 if between else 0.0
    first = math.ceil(low / step - offset)
    last = math.floor(high / step - offset)
    if last - first > 60:
        return []
    return [(number + offset) * step for number in range(first, last + 1)]


def _round_length(metres: float) -> float:
    power: float = 10.0 ** math.floor(math.log10(metres))
    return max(step * power for step in (1, 2, 5) if step * power <= metres)


def _track(seen: SeenTopic, points: list[Point], frame: PlaceFrame) -> list[SvgElement]:
    # The track, the older the paler; pieces share their ends, so that no gap shows.
    thinned = points[:: max(1, len(points) // _MAX_POINTS)]
    drawn = [frame.at(point) for point in (*thinned, points[-1])]
    size = max(2, math.ceil(len(drawn) / _SHADES))
    pieces = [drawn[start : start + size + 1] for start in range(0, len(drawn), size)]
    shades = range(_SHADES - len(pieces) + 1, _SHADES + 1)
    found = [path(each, f"track shade{at}") for at, each in zip(shades, pieces, strict=True) if len(each) > 1]
    # Where it is now, and where it looks, if the message says so by a quaternion.
    x, y = drawn[-1]
    found.append(circle((x, y), 11.0, "halo"))
    field = _POSITION.get(seen.type, "").rpartition("position")[0]
    with suppress(KeyError, TypeError):
        turn = _read(seen.samples[-1], f"{field}orientation")
        z, w = float(turn["z"]), float(turn["w"])
        if math.isfinite(z) and math.isfinite(w) and (z, w) != (0.0, 0.0):
            heading = 2 * math.atan2(z, w)
            tip = [
                (x + reach * math.cos(heading + turned), y - reach * math.sin(heading + turned))
                for turned, reach in ((0.5, 10), (0.0, 22), (-0.5, 10))
            ]
            found.append(path([_inside(each) for each in tip], "heading"))
    return [*found, circle((x, y), 4.5, "here")]


def _inside(point: Point) -> Point:
    return min(max(point[0], 0.0), WIDTH), min(max(point[1], 0.0), HEIGHT)


def _squares(points: list[Point], frame: PlaceFrame, cell: Extent) -> list[SvgElement]:
    counts = Counter(points)
    most = max(counts.values())
    wide, high = cell[0] * frame.scale, cell[1] * frame.scale
    squares = []
    for point, times in counts.most_common(_MAX_CELLS):
        x, y = frame.at(point)
        shade = max(1, math.ceil(_SHADES * times / most))
        now = " now" if point == points[-1] else ""
        left, right = min(max(x - wide / 2, 0.0) + 1, WIDTH - 2), min(x + wide / 2, WIDTH) - 1
        top, bottom = min(max(y - high / 2, 0.0) + 1, HEIGHT - 2), min(y + high / 2, HEIGHT) - 1
        size = max(right - left, 1.0), max(bottom - top, 1.0)
        squares.append(box(left, top, *size, 4.0, f"square shade{shade}{now}"))
    return squares
