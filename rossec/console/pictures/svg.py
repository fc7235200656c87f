"""Elements of SVG, built so that no text becomes markup and no style leaves the stylesheet. Pure.

A class, never a `style` attribute: the pages' policy (CSP `style-src 'self'`) forbids those, and dark mode
needs the classes. An element is safe where `__html__` is asked for (jinja2), as it escapes what it was given.
"""

import math
import re
from collections.abc import Iterable
from typing import Final, TypeAlias
from xml.sax.saxutils import escape

from rossec.peer_limits import printable

NAMESPACE: Final = "http://www.w3.org/2000/svg"
MAX_TEXT: Final = 200
_TAGS: Final = frozenset(
    {"circle", "desc", "g", "image", "line", "path", "polyline", "rect", "svg", "text", "title"}
)
_ATTRIBUTE: Final = re.compile(r"[a-zA-Z][a-zA-Z0-9-]*", re.ASCII)
_FORBIDDEN: Final = ("style", "href", "src")  # `image` adds its own
_PICTURE: Final = "data:image/png;base64,"

Child: TypeAlias = "SvgElement | str"
Point: TypeAlias = tuple[float, float]


class SvgElement:
    __slots__ = ("_text",)

    def __init__(self, tag: str, *children: Child, **attributes: object) -> None:
        if tag not in _TAGS:
            raise ValueError(f"no {tag[:20]!r} in a picture")
        written = ""
        for name, value in attributes.items():
            # A node's word in an attribute would be a script or a style of its own choice.
            shown = name.rstrip("_").replace("_", "-")
            if shown in _FORBIDDEN or shown.startswith("on") or _ATTRIBUTE.fullmatch(shown) is None:
                raise ValueError(f"no attribute {name[:20]!r} in a picture")
            text = number(value) if isinstance(value, int | float) else str(value)
            written += f' {shown}="{escape(printable(text, len(text)), {chr(34): "&quot;"})}"'
        content = "".join(map(_child, children))
        self._text = f"<{tag}{written}>{content}</{tag}>" if content else f"<{tag}{written}/>"

    def __str__(self) -> str:
        return self._text

    def __html__(self) -> str:
        return self._text

    @classmethod
    def picture(cls, data: str, **attributes: object) -> "SvgElement":
        if re.fullmatch(r"[A-Za-z0-9+/]+={0,2}", data) is None:
            raise ValueError("not base64")
        made = cls("image", **attributes)
        made._text = f'{made._text[:-2]} href="{_PICTURE}{data}"/>'
        return made


def _child(child: Child) -> str:
    return str(child) if isinstance(child, SvgElement) else escape(printable(child, MAX_TEXT))


def number(value: float) -> str:
    if not math.isfinite(value):
        raise ValueError("a coordinate that is not finite")
    text = f"{value:.1f}".removesuffix(".0")
    return "0" if text == "-0" else text


def drawing(width: float, height: float, title: str, *children: Child, class_: str = "") -> SvgElement:
    """A picture of this size; `title` is what it shows, for those who cannot see it."""
    return SvgElement(
        "svg",
        SvgElement("title", title),
        *children,
        viewBox=f"0 0 {number(width)} {number(height)}",
        class_=f"picture {class_}".strip(),
        role="img",
        xmlns=NAMESPACE,
    )


def path(points: Iterable[Point], class_: str) -> SvgElement:
    pairs = [f"{number(x)} {number(y)}" for x, y in points]
    return SvgElement("path", d=f"M{' L'.join(pairs)}", class_=class_)


def curve(start: Point, end: Point, class_: str) -> SvgElement:
    (x, y), (to_x, to_y) = start, end
    middle = number((x + to_x) / 2)
    line = f"M{number(x)} {number(y)} C{middle} {number(y)} {middle} {number(to_y)}"
    return SvgElement("path", d=f"{line} {number(to_x)} {number(to_y)}", class_=class_)


def along(start: Point, end: Point, at: float) -> Point:
    (x, y), (to_x, to_y) = start, end
    rest, middle = 1 - at, (x + to_x) / 2
    first, inner, last = rest**3, 3 * rest * at, at**3
    return (
        first * x + inner * (rest + at) * middle + last * to_x,
        y * (first + inner * rest) + to_y * (inner * at + last),
    )


def box(left: float, top: float, width: float, height: float, rx: float, class_: str) -> SvgElement:
    return SvgElement("rect", x=left, y=top, width=width, height=height, rx=rx, class_=class_)


def circle(middle: Point, radius: float, class_: str) -> SvgElement:
    return SvgElement("circle", cx=middle[0], cy=middle[1], r=radius, class_=class_)


def ground(width: float, height: float) -> SvgElement:
    return SvgElement("rect", width=width, height=height, class_="ground", rx=8.0)


def label(x: float, y: float, text: str, class_: str = "", anchor: str = "start") -> SvgElement:
    return SvgElement("text", text, x=x, y=y, class_=class_, text_anchor=anchor)


def cut(text: str, most: int) -> str:
    return text if len(text) <= most else f"…{text[1 - most :]}"
