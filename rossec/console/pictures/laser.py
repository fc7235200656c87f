"""A laser scan: the room as its rays met it, from above. Pure.

The last scan is drawn. Rounded distances show as rings, removed ones as an empty circle.
"""

import math
from typing import Final

from rossec.console.pictures.svg import Element, Point, drawing, label, path
from rossec.console.samples import SeenTopic

TYPE: Final = "sensor_msgs/LaserScan"
SIZE: Final = 300.0
_MIDDLE: Final = SIZE / 2
_REACH: Final = SIZE / 2 - 14
_RINGS: Final = 3
_MAX_RAYS: Final = 360
_MAX_ANGLE: Final = 1e3
_FAR: Final = 1e6  # metres: what is farther is no wall


def reach_of(seen: SeenTopic) -> float:
    """The longest distance that the last scan has, in metres; 0 if there is none."""
    return max((distance for _, distance in _rays(seen)), default=0.0)


def draw(seen: SeenTopic, reach: float) -> Element | None:
    """The last scan, with `reach` metres from the middle to the edge; None without a scan."""
    if not seen.samples:
        return None
    scale = _REACH / reach if reach > 0 else 0.0
    rings = [
        Element("circle", cx=_MIDDLE, cy=_MIDDLE, r=_REACH * number / _RINGS, class_="grid ring")
        for number in range(1, _RINGS + 1)
    ]
    hits = [_at(angle, distance * scale) for angle, distance in _rays(seen)]
    dots = [Element("circle", cx=x, cy=y, r=1.6, class_="hit") for x, y in hits]
    text = [label(_MIDDLE, SIZE - 2, f"{reach:.3g} m", "ruler-text", "middle")] if scale else []
    here = Element("circle", cx=_MIDDLE, cy=_MIDDLE, r=4.5, class_="here")
    outline = [path([*hits, hits[0]], "outline")] if len(hits) > 2 else []
    said = f"{len(hits)} rays that {seen.receiver} sees, from above"
    return drawing(SIZE, SIZE, said, *rings, *outline, *dots, here, *text, class_="laser")


def _rays(seen: SeenTopic) -> list[Point]:
    """Angle and distance of each ray of the last scan that met something."""
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


def _at(angle: float, distance: float) -> Point:
    far = min(distance, _REACH)
    return _MIDDLE + far * math.cos(angle), _MIDDLE - far * math.sin(angle)
