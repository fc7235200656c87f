"""What a topic looks like to each of its receivers: one picture for each way to see it. Pure.

A type has a picture (`place`, `laser`, `image`, `series`) or its fields as text, with those struck
that a receiver does not get. All receivers with the same restrictions share one.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from grants.model import FilterRule
from grants.policy.privacy import filters_of
from rossec.console import words
from rossec.console.matrix import SEEING, Access, Cell
from rossec.console.pictures import image, laser, place, series
from rossec.console.pictures.svg import Element
from rossec.console.samples import Recorded, SeenTopic, try_see
from rossec.ros.text import printable

MAX_LOOKS: Final = 6
MAX_FIELDS: Final = 24
MAX_MESSAGES: Final = 600
_LAST: Final = 3
_MAX_VALUE: Final = 60
_REMOVING: Final = ("clear", "drop", "zero")


class FieldLine(NamedTuple):
    """A field of a message as text; `removed`: the receiver gets nothing in its place."""

    path: str
    value: str
    removed: bool


class Look(NamedTuple):
    """How some receivers see a topic: a heading, a line below it, and a picture or fields."""

    receivers: tuple[str, ...]
    heading: str
    caption: str
    access: Access
    picture: Element | None
    fields: tuple[FieldLine, ...]


class Comparison(NamedTuple):
    """The looks of one topic; `more`: ways to see it that are not shown."""

    topic: str
    type: str
    looks: tuple[Look, ...]
    more: int
    is_made_up: bool


def compare(recorded: Recorded, cells: Iterable[Cell]) -> Comparison:
    """The different ways in which the receivers of `cells` see `recorded`, the widest first.

    There is none if the type of the messages is not known here.
    """
    ways: dict[Any, list[Cell]] = {}
    for cell in cells:
        if cell.access in SEEING:
            ways.setdefault(cell.restrictions, []).append(cell)
    groups = sorted(ways.values(), key=lambda group: (bool(group[0].restrictions), group[0]))
    shown = groups[:MAX_LOOKS]
    recorded = recorded._replace(messages=recorded.messages[-_newest(recorded.type) :])
    exact = try_see(recorded, "", ())
    if exact is None:
        return Comparison(recorded.topic, recorded.type, (), 0, recorded.is_made_up)
    seen = [try_see(recorded, group[0].receiver, group[0].restrictions) for group in shown]
    cells = [group[0] for group in shown]
    drawer = _drawer(exact, [each for each in seen if each], cells, minutes(recorded))
    looks = tuple(_look(drawer, group, each) for group, each in zip(shown, seen, strict=True))
    return Comparison(
        recorded.topic, recorded.type, looks, len(groups) - len(shown), recorded.is_made_up
    )


def _newest(kind: str) -> int:
    """How many messages are looked at: of a picture or a scan only the last is drawn."""
    return _LAST if kind in (laser.TYPE, image.TYPE) else MAX_MESSAGES


class _Drawer(NamedTuple):
    """What the pictures of one topic share; `during` is how long all of it took."""

    frame: place.Frame | None
    reach: float
    field: str
    span: series.Span | None
    during: str


def minutes(recorded: Recorded) -> int:
    """How many minutes the messages took, begun ones included."""
    times = [at for at, _ in recorded.messages]
    return max(1, math.ceil((max(times) - min(times)) / 60)) if times else 1


def _drawer(exact: SeenTopic, seen: list[SeenTopic], cells: list[Cell], long: int) -> _Drawer:
    restrictions = [each for cell in cells for each in cell.restrictions]
    frame = place.frame_of([exact], restrictions) if place.has_place(exact.type) else None
    is_scan = exact.type == laser.TYPE
    reach = max(map(laser.reach_of, [exact, *seen])) if is_scan else 0.0
    drawn = frame is not None or exact.type in (laser.TYPE, image.TYPE)
    field = "" if drawn else series.field_of(exact)
    during = "in this minute" if long == 1 else f"in these {long} minutes"
    return _Drawer(frame, reach, field, series.span_of([exact, *seen], field), during)


def _look(drawer: _Drawer, group: Sequence[Cell], seen: SeenTopic | None) -> Look:
    cell = group[0]
    receivers = tuple(each.receiver for each in group)
    if seen is None:
        said = "gets nothing: the grant does not fit these messages"
        return Look(receivers, said, cell.words, cell.access, None, ())
    got = len(seen.samples)
    if got == 0:
        caption = f"none of {words.count(seen.sent, 'message')} passed: {cell.words}"
        return Look(receivers, "gets none of these", caption, cell.access, None, ())
    heading, detail, picture = _picture(drawer, cell, seen)
    caption = ": ".join(filter(None, (detail, cell.words)))
    lines = () if picture is not None else _fields(seen, cell)
    return Look(receivers, heading, printable(caption, 400), cell.access, picture, lines)


def _picture(drawer: _Drawer, cell: Cell, seen: SeenTopic) -> tuple[str, str, Element | None]:
    """Heading, how much it is, and the picture; without one the fields are shown."""
    messages = words.count(len(seen.samples), "message")
    if drawer.frame is not None:
        return _place(drawer.frame, cell, seen, drawer.during)
    if seen.type == laser.TYPE:
        return "sees what the laser meets", "", laser.draw(seen, drawer.reach)
    if seen.type == image.TYPE:
        heading = "sees this of the picture" if cell.restrictions else "sees the picture"
        return heading, "", image.draw(seen)
    if drawer.field and drawer.span is not None:
        name = words.field_name(drawer.field, seen.type)
        return f"sees the {name}", messages, series.draw(seen, drawer.field, drawer.span)
    return "sees these fields", messages, None


def _place(
    frame: place.Frame, cell: Cell, seen: SeenTopic, during: str
) -> tuple[str, str, Element | None]:
    cells = place.cells_of(cell.restrictions, frame.origin)
    picture = place.draw(seen, frame, max(cells, default=None))
    if picture is None:
        messages = words.count(len(seen.samples), "message")
        return "does not see the place", f"{messages} {during}", None
    number = place.places(seen)
    if cells:
        squares = words.count(number, "square")
        return "sees which square", f"{squares} {during}", picture
    places = words.count(number, "place")
    return "sees the exact place", f"{places} {during}", picture


def _fields(seen: SeenTopic, cell: Cell) -> tuple[FieldLine, ...]:
    """The last message as text; what a filter removed has no value."""
    rules = [rule for each in cell.restrictions for rule in each.filters]
    found: list[FieldLine] = []
    _walk(seen.samples[-1].fields, "", rules, found)
    return tuple(found[:MAX_FIELDS])


def _walk(
    fields: Mapping[str, Any], above: str, rules: list[FilterRule], found: list[FieldLine]
) -> None:
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
