"""The numbers of methods are part of the format."""

import re
from pathlib import Path

from rossec.ros.calls import METHODS, NUMBERS

SPEC = Path(__file__).parents[3] / "docs" / "spec" / "compact.md"


def test_the_numbers_are_those_of_the_specification() -> None:
    rows = re.findall(r"^\| (\d+) \| `([\w.]+)` \|", SPEC.read_text(), re.MULTILINE)
    assert {name: int(number) for number, name in rows} == NUMBERS
    assert len(rows) == len(METHODS)


def test_the_numbers_never_change() -> None:
    """If this fails, the change is to be undone: peers of before take the numbers as they were."""
    known = (METHODS[0], METHODS[14], METHODS[23], METHODS[24], METHODS[60])
    assert known == ("getParam", "requestTopic", "getUri", "getPublishedTopics", "rossec.ports")
    assert len(METHODS) == 61
