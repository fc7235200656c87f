"""The way it goes: who sends, what, who sees it, in three columns. Pure.

Solid for everything, dotted for coarse, dashed and struck for ended; so no line needs its colour to
be understood. What was refused is a short end at the receiver. Only so many boxes are drawn; the
page says the same as a list, whole.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from rossec.console.matrix import Access, Matrix
from rossec.console.pictures.svg import Element, Point, curve, cut, drawing, label, path

MAX_ROWS: Final = 12
_PITCH, _BOX, _TOP = 54.0, 36.0, 36.0
_SENDERS, _TOPICS, _RECEIVERS = (0.0, 145.0), (195.0, 385.0), (455.0, 600.0)
_WIDTH: Final = 600.0
_STUB: Final = 130.0
_LETTERS: Final = {145.0: 16, 190.0: 21}  # that fit a box of this width


def draw(matrix: Matrix, refused: Mapping[str, Sequence[str]] | None = None) -> Element | None:
    """The flow of the first rows and receivers of `matrix`; None where nothing flows.

    Args:
        refused: by receiver, the names that it was refused; one that may see nothing else has
            a box too.
    """
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
        curve((_SENDERS[1], left[name]), (_TOPICS[0], middle[row.topic]), "sent")
        for row in shown.rows
        for name in row.publishers
        if name in left
    ]
    parts = [*_heads(), *sent, *_seen(shown, middle, right)]
    parts += _column(left, _SENDERS, "box end") + _column(middle, _TOPICS, "box")
    parts += _column(right, _RECEIVERS, "box end")
    stubs = [_stub(right[name], names) for name, names in ends.items() if name in right]
    wide = _WIDTH + (_STUB if stubs else 0.0)
    said = f"{len(senders)} senders, {len(shown.rows)} topics, {len(receivers)} receivers"
    return drawing(wide, height, said, *parts, *stubs, class_="flow")


def _first(names: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(names))[:MAX_ROWS]


def _heads() -> list[Element]:
    return [
        label(column[0], 16, text, "head")
        for column, text in (
            (_SENDERS, "comes from"),
            (_TOPICS, "what"),
            (_RECEIVERS, "is seen by"),
        )
    ]


def _spread(names: Sequence[str], height: float) -> dict[str, float]:
    """The heights of the middles of boxes, evenly over the column."""
    pitch = (height - _TOP) / max(1, len(names))
    return {name: _TOP + pitch * (at + 0.5) for at, name in enumerate(names)}


def _column(places: Mapping[str, float], column: Point, class_: str) -> list[Element]:
    left, right = column
    boxes = []
    for name, y in places.items():
        text = cut(name, _LETTERS[right - left])
        boxes.append(
            Element(
                "g",
                Element("title", name),
                Element(
                    "rect", x=left + 0.5, y=y - _BOX / 2, width=right - left - 1, height=_BOX,
                    rx=9.0, class_=class_,
                ),
                label((left + right) / 2, y + 5, text, "box-name", "middle"),
            )
        )  # fmt: skip
    return boxes


def _seen(matrix: Matrix, middle: Mapping[str, float], right: Mapping[str, float]) -> list[Element]:
    lines, badges = [], []
    for row in matrix.rows:
        for cell in row.cells:
            if cell.access is Access.NOTHING or cell.receiver not in right:
                continue
            start, end = (_TOPICS[1], middle[row.topic]), (_RECEIVERS[0], right[cell.receiver])
            lines.append(curve(start, end, f"flow-{cell.access}"))
            if cell.access is Access.ENDED:
                badges.append(_cross((start[0] + end[0]) / 2, (start[1] + end[1]) / 2))
    return [*lines, *badges]


def _cross(x: float, y: float) -> Element:
    return Element(
        "g",
        Element("circle", cx=x, cy=y, r=9.0, class_="badge"),
        path([(x - 4, y - 4), (x + 4, y + 4)], "cross"),
        path([(x - 4, y + 4), (x + 4, y - 4)], "cross"),
    )


def _stub(y: float, names: Sequence[str]) -> Element:
    """The dead end of a receiver: the name that it was refused, or how many."""
    start = _RECEIVERS[1]
    said = cut(names[0], 13) if len(names) == 1 else f"{len(names)} refused"
    return Element(
        "g",
        Element("title", "refused: " + ", ".join(names[:8])),
        path([(start, y), (start + 17, y)], "flow-ended"),
        _cross(start + 26, y),
        label(start + 39, y + 4, said, "stub"),
    )
