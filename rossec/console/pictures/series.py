"""A number over the last minute, as a line. Pure.

What is drawn is the first number of a message that changes, or its first at all. A rounded one is a
staircase, which a line through its points shows by itself.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final, NamedTuple

from rossec.console.pictures.svg import Element, Point, drawing, label, path
from rossec.console.samples import SeenTopic

WIDTH, HEIGHT = 300.0, 100.0
_EDGE: Final = 10.0
_MAX_POINTS: Final = 300
_LARGE: Final = 1e300  # a difference of two is still a number
_NOT_SHOWN: Final = ("seq", "stamp", "sec", "nanosec")


class Span(NamedTuple):
    """The range of both axes, the same for all receivers."""

    first: float
    last: float
    low: float
    high: float


def field_of(seen: SeenTopic) -> str:
    """The path of the number to draw; empty if no message has one."""
    if not seen.samples:
        return ""
    last = dict(_numbers(seen.samples[-1].fields, ""))
    first = dict(_numbers(seen.samples[0].fields, ""))
    changing = [path_ for path_, value in last.items() if first.get(path_) != value]
    return next(iter([*changing, *last]), "")


def span_of(seen: Iterable[SeenTopic], field: str) -> Span | None:
    """The span of the field in all of `seen`; None without a value."""
    points = [point for each in seen for point in _points(each, field)]
    if not points:
        return None
    times, values = [at for at, _ in points], [value for _, value in points]
    return Span(min(times), max(times), min(values), max(values))


def draw(seen: SeenTopic, field: str, span: Span) -> Element | None:
    """The values of `field` as a line; None if this receiver got none."""
    points = _points(seen, field)
    if not points:
        return None
    every = max(1, math.ceil(len(points) / _MAX_POINTS))
    drawn = [_at(point, span) for point in points[::every]]
    parts = [
        Element("rect", width=WIDTH, height=HEIGHT, class_="ground", rx=8.0),
        path([(drawn[0][0], drawn[0][1]), *drawn], "track shade5"),
        Element("circle", cx=drawn[-1][0], cy=drawn[-1][1], r=4.0, class_="here"),
        label(_EDGE, _EDGE + 5, f"{span.high:.4g}", "ruler-text"),
        label(_EDGE, HEIGHT - 5, f"{span.low:.4g}", "ruler-text"),
    ]
    values = {value for _, value in points}
    said = f"{field}: {len(values)} different values that {seen.receiver} sees"
    return drawing(WIDTH, HEIGHT, said, *parts, class_="series")


def _at(point: Point, span: Span) -> Point:
    at, value = point
    long, high = span.last - span.first or 1.0, span.high - span.low
    x = _EDGE + (WIDTH - 2 * _EDGE) * (at - span.first) / long
    level = (value - span.low) / high if high else 0.5
    return x, HEIGHT - _EDGE - 12 - (HEIGHT - 2 * _EDGE - 24) * level


def _points(seen: SeenTopic, field: str) -> list[Point]:
    found = []
    for sample in seen.samples:
        value = dict(_numbers(sample.fields, "")).get(field)
        if value is not None:
            found.append((sample.at, value))
    return found


def _numbers(fields: Mapping[str, Any], above: str) -> Iterator[tuple[str, float]]:
    for name, value in fields.items():
        if name in _NOT_SHOWN:
            continue
        if isinstance(value, Mapping):
            yield from _numbers(value, f"{above}{name}.")
        elif _is_number(value):
            yield f"{above}{name}", float(value)


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) < _LARGE
