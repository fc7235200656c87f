"""A sheet of labels to print: one page of HTML per 24 nodes, each label an SVG in millimetres.

A label authenticates a request and holds no secret, so it may stay on the robot. The layout is that
of the common A4 sheets of 24 labels, 63.5 by 33.9 mm; everything is drawn in SVG, so that browsers
do not change the layout, and the page cannot load or run anything.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

from ca.enrollment.qr import inline_svg

COLUMNS, ROWS = 3, 8
PER_PAGE: Final = COLUMNS * ROWS
_WIDTH, _HEIGHT = 63.5, 33.9  # millimetres
_STEP: Final = 66.0  # from label to label, sideways
_LEFT, _TOP = 7.25, 12.9
_CODE: Final = 33.0  # with its quiet zone: 0.8 mm a module
_LINE: Final = 17  # characters of a name that fit beside the code
_LINES: Final = 5
_PAGE: Final = (
    '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>rossec labels</title>\n'
    '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
    "style-src 'unsafe-inline'\">\n"
    "<style>@page {{ size: A4; margin: 0 }} body {{ margin: 0 }} "
    "svg.page {{ display: block; break-after: page }}</style></head>\n<body>\n{}</body></html>\n"
)


@dataclass(frozen=True)
class Label:
    """One label: the node's name, its key's fingerprint, the text of its code."""

    name: str
    fingerprint: str
    text: str


def sheet(labels: Sequence[Label]) -> str:
    """The labels as one HTML page, to be printed without scaling."""
    starts = range(0, len(labels), PER_PAGE)
    return _PAGE.format("".join(_page(labels[start : start + PER_PAGE]) for start in starts))


def _page(labels: Sequence[Label]) -> str:
    drawn = "".join(_label(position, label) for position, label in enumerate(labels))
    return (
        '<svg class="page" xmlns="http://www.w3.org/2000/svg" width="210mm" height="297mm" '
        f'viewBox="0 0 210 297"><rect width="210" height="297" fill="white"/>{drawn}</svg>\n'
    )


def _label(position: int, label: Label) -> str:
    row, column = divmod(position, COLUMNS)
    left, top = _LEFT + column * _STEP, _TOP + row * _HEIGHT
    return (
        f'<svg x="{left}" y="{top}" width="{_WIDTH}" height="{_HEIGHT}">'
        f'<svg width="{_CODE}" height="{_CODE}">{inline_svg(label.text)}</svg>'
        f"{''.join(_lines(label))}</svg>"
    )


def _lines(label: Label) -> Iterator[str]:
    """The name, split into lines if it is long, and below it the fingerprint."""
    name = [label.name[start : start + _LINE] for start in range(0, len(label.name), _LINE)]
    if len(name) > _LINES:
        name = [*name[: _LINES - 1], "..."]
    digits = label.fingerprint
    groups = [
        digits[start : start + 10] for start in range(0, len(digits), 10)
    ]  # two groups of four a line
    for number, text in enumerate([*name, *groups]):
        weight = ' font-weight="bold"' if number < len(name) else ""
        yield (
            f'<text x="{_CODE}" y="{5 + 3 * number}" font-family="monospace" font-size="2.6"'
            f"{weight}>{escape(text)}</text>"
        )
