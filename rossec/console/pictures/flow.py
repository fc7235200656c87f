"""The data flow: who sends, what, who sees it, in three columns. Pure.

Solid for everything, dotted for coarse, dashed for ending, dashed and struck for ended; so no line
needs its colour to be understood. What was refused is a short end at the receiver. Only so many
boxes are drawn; the page says the same as a list, whole.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final, TypeAlias

from rossec.console.matrix import Matrix, TopicAccess
from rossec.console.pictures import svg

MAX_ROWS: Final = 12
Line: TypeAlias = tuple[svg.Point, svg.Point]
_PITCH, _BOX, _TOP = 54.0, 36.0, 36.0
_SENDERS, _TOPICS, _RECEIVERS = (0.0, 145.0), (195.0, 385.0), (455.0, 600.0)
_WIDTH: Final = 600.0
_STUB: Final = 130.0
_FREE: Final = 16.0  # from the middle of a mark to another line: its radius is 9
_LETTERS: Final = {145.0: 16, 190.0: 21}  # that fit a box of this width


def draw(
    matrix: Matrix,
    refused: Mapping[str, Sequence[str]] | None = None,
    title: Callable[[str], str] = lambda _: "",
) -> svg.SvgElement | None:
    shown = matrix.window(slice(MAX_ROWS), slice(MAX_ROWS))
    ends = {name: found for name, found in (refused or {}).items() if found}
    receivers = _first([*shown.receivers, *sorted(ends)])
    senders = _first(name for row in shown.rows for name in row.publishers)
    if not shown.rows and not ends:
        return None
    height = _TOP + _PITCH * max(len(senders), len(shown.rows), len(receivers))
    left = _spread(senders, height)
    middle = _spread([row.topic for row in shown.rows], height)
    right = _spread(receivers, height)
    sent = [
        svg.curve((_SENDERS[1], left[name]), (_TOPICS[0], middle[row.topic]), "sent")
        for row in shown.rows
        for name in row.publishers
        if name in left
    ]
    columns = ((_SENDERS, "comes from"), (_TOPICS, "what"), (_RECEIVERS, "is seen by"))
    heads = [svg.label(column[0], 16, text, "head") for column, text in columns]
    parts = [*heads, *sent, *_seen(shown, middle, right)]
    parts += _column(left, _SENDERS, "box end", title) + _column(middle, _TOPICS, "box", title)
    parts += _column(right, _RECEIVERS, "box end", title)
    # What was refused is a short end at the receiver: there is no line that it could come from.
    stubs, start = [], _RECEIVERS[1]
    for name, names in ends.items():
        if name in right:
            y, short = right[name], svg.cut(names[0], 13) if len(names) == 1 else f"{len(names)} refused"
            title_ = svg.SvgElement("title", "refused: " + ", ".join(names[:8]))
            line = svg.path([(start, y), (start + 17, y)], "flow-ended")
            text = svg.label(start + 39, y + 4, short, "stub")
            stubs.append(svg.SvgElement("g", title_, line, _cross(start + 26, y), text))
    wide = _WIDTH + (_STUB if stubs else 0.0)
    said = f"{len(senders)} senders, {len(shown.rows)} topics, {len(receivers)} receivers"
    return svg.drawing(wide, height, said, *parts, *stubs, class_="flow")


def _first(names: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(names))[:MAX_ROWS]


def _spread(names: Sequence[str], height: float) -> dict[str, float]:
    pitch = (height - _TOP) / max(1, len(names))
    return {name: _TOP + pitch * (at + 0.5) for at, name in enumerate(names)}


def _column(
    places: Mapping[str, float], column: svg.Point, class_: str, title: Callable[[str], str]
) -> list[svg.SvgElement]:
    left, right = column
    boxes = []
    for name, y in places.items():
        called, most, middle = title(name), _LETTERS[right - left], (left + right) / 2
        texts = [svg.label(middle, y + 5, svg.cut(name, most), "box-name", "middle")]
        if called:  # never alone: two names may be called alike, to the eye
            short = called if len(called) <= most else f"{called[: most - 1]}…"
            texts = [
                svg.label(middle, y - 2, short, "box-title", "middle"),
                svg.label(middle, y + 13, svg.cut(name, most), "box-name", "middle"),
            ]
        frame = svg.box(left + 0.5, y - _BOX / 2, right - left - 1, _BOX, 9.0, class_)
        boxes.append(svg.SvgElement("g", svg.SvgElement("title", f"{called} {name}".strip()), frame, *texts))
    return boxes


def _seen(matrix: Matrix, middle: Mapping[str, float], right: Mapping[str, float]) -> list[svg.SvgElement]:
    drawn = [
        (cell.access, (_TOPICS[1], middle[row.topic]), (_RECEIVERS[0], right[cell.receiver]))
        for row in matrix.rows
        for cell in row.cells
        if cell.access is not TopicAccess.NOTHING and cell.receiver in right
    ]
    lines = [svg.curve(start, end, f"flow-{access}") for access, start, end in drawn]
    ended = [(start, end) for access, start, end in drawn if access is TopicAccess.ENDED]
    others = [(start, end) for access, start, end in drawn if access is not TopicAccess.ENDED]
    return [*lines, *(_cross(*place) for place in free_places(ended, others))]


def free_places(struck: Sequence[Line], others: Sequence[Line]) -> list[svg.Point]:
    """Where the mark of each struck line is: on it, as far as can be from all other lines."""
    # A mark on the crossing of two lines would strike the wrong one.
    taken = [svg.along(start, end, at / 40) for start, end in others for at in range(41)]
    places: list[svg.Point] = []
    for line in struck:
        rest = [each for each in struck if each != line]
        beside = [svg.along(*each, at / 40) for each in rest for at in range(41)]
        candidates = [svg.along(*line, at / 40) for at in range(6, 35)]
        points = [*taken, *beside, *places]
        # The middle is what people look at first: it wins where it is free.
        candidates.sort(key=lambda each: abs(each[0] - (line[0][0] + line[1][0]) / 2))
        places.append(max(candidates, key=lambda each: min(_FREE, _distance(each, points))))
    return places


def _distance(point: svg.Point, points: Iterable[svg.Point]) -> float:
    return min((math.dist(point, each) for each in points), default=math.inf)


def _cross(x: float, y: float) -> svg.SvgElement:
    return svg.SvgElement(
        "g",
        svg.circle((x, y), 9.0, "badge"),
        svg.path([(x - 4, y - 4), (x + 4, y + 4)], "cross"),
        svg.path([(x - 4, y + 4), (x + 4, y - 4)], "cross"),
    )
