"""A picture of the console as a strict reader of XML sees it."""

import re
from typing import Final
from xml.etree.ElementTree import Element as Xml

from defusedxml.ElementTree import fromstring

from rossec.console.pictures.svg import NAMESPACE, SvgElement

_X: Final = ("x", "cx", "x1", "x2")
_Y: Final = ("y", "cy", "y1", "y2")


def checked(picture: SvgElement | None) -> Xml:
    """The parsed picture; every number in it lies within the view box, and nothing has a style."""
    assert picture is not None
    root: Xml = fromstring(str(picture))
    assert root.tag == f"{{{NAMESPACE}}}svg"
    assert root.findtext(f"{{{NAMESPACE}}}title")
    _, _, width, height = map(float, root.attrib["viewBox"].split())
    for each in root.iter():
        assert each.tag.startswith(f"{{{NAMESPACE}}}")
        assert not {"style", "onload", "onclick"} & each.attrib.keys()
        _check(each, width, height)
    return root


def classes(root: Xml) -> list[str]:
    """The classes of all its elements, in order."""
    return [each.attrib["class"] for each in root.iter() if "class" in each.attrib]


def texts(root: Xml) -> list[str]:
    """All text in it, titles included."""
    return [each.text for each in root.iter() if each.text]


def _check(each: Xml, width: float, height: float) -> None:
    for names, limit in ((_X, width), (_Y, height)):
        for name in names:
            if name in each.attrib:
                assert 0 <= float(each.attrib[name]) <= limit, (each.tag, each.attrib)
    if "width" in each.attrib and "x" in each.attrib:
        assert float(each.attrib["x"]) + float(each.attrib["width"]) <= width + 0.2
        assert float(each.attrib["y"]) + float(each.attrib["height"]) <= height + 0.2
    numbers = list(map(float, re.findall(r"-?[0-9.]+", each.attrib.get("d", ""))))
    assert all(0 <= number <= width for number in numbers[::2]), each.attrib
    assert all(0 <= number <= height for number in numbers[1::2]), each.attrib
