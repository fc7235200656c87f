"""Elements of SVG: no text becomes markup, no style, no number out of its place."""

import math
from typing import Any

import pytest

from rossec.console.pictures.svg import SvgElement, curve, cut, drawing, label, number, path
from tests.support.consolehome import HOSTILE
from tests.support.drawings import checked, texts


def test_a_text_never_becomes_markup() -> None:
    made = drawing(100, 50, HOSTILE, label(5, 20, HOSTILE, class_=HOSTILE))
    assert "<script" not in str(made)
    assert "\u202e" not in str(made)
    root = checked(made)
    assert len(texts(root)) == 2
    assert all(text.startswith("<script>") and len(text) <= 210 for text in texts(root))
    assert made.__html__() == str(made)


@pytest.mark.parametrize("tag", ["a", "script", "foreignObject", "style", "use"])
def test_other_elements_are_refused(tag: str) -> None:
    with pytest.raises(ValueError, match="in a picture"):
        SvgElement(tag)


@pytest.mark.parametrize("name", ["style", "href", "onload", "on_click", "src", 'x"y', "a b"])
def test_other_attributes_are_refused(name: str) -> None:
    attributes: dict[str, Any] = {name: "1"}
    with pytest.raises(ValueError, match="in a picture"):
        SvgElement("rect", **attributes)


def test_an_image_is_base64_or_refused() -> None:
    assert 'href="data:image/png;base64,AAAA"' in str(SvgElement.picture("AAAA", width=5.0))
    with pytest.raises(ValueError, match="not base64"):
        SvgElement.picture('AA"onload="x')


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_not_finite_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match="finite"):
        SvgElement("circle", cx=value)


def test_numbers_are_short() -> None:
    assert [number(each) for each in (1.0, 1.26, -0.01, -2.5)] == ["1", "1.3", "0", "-2.5"]


def test_lines_are_paths() -> None:
    assert str(path([(0, 1), (2, 3.25)], "a")) == '<path d="M0 1 L2 3.2" class="a"/>'
    assert 'd="M0 1 C5 1 5 9 10 9"' in str(curve((0, 1), (10, 9), "a"))


def test_the_end_of_a_long_text_is_kept() -> None:
    assert cut("/robot/pose", 20) == "/robot/pose"
    assert cut("/robot/pose", 6) == "…/pose"
