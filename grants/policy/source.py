"""From YAML text to a tree in which every part has its position. A subset of YAML 1.2.

`grants.yaml_text` bounds the text and refuses anchors, aliases, tags, directives and further
documents; duplicate keys are refused here: otherwise the second of two equal keys would silently
win. Plain scalars are texts unless they are clearly a number or true/false: `22:00`, `no` and
`2026-11-20` stay as written.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from ruamel.yaml.events import (
    MappingEndEvent,
    NodeEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
)

from grants.errors import YamlRefused
from grants.model import Scalar
from grants.policy.mistakes import Mistakes
from grants.yaml_text import Bounds, events, is_quoted, position

BOUNDS: Final = Bounds()  # 10,000 rules of 400 characters and 30 events
MAX_SIZE: Final = BOUNDS.size

_INT: Final = re.compile(r"[-+]?[0-9]{1,18}", re.ASCII)
_FLOAT: Final = re.compile(
    r"[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+|[0-9]+)(?:[eE][-+]?[0-9]{1,3})?", re.ASCII
)
_UNQUOTED: Final = re.compile(r"(?<![\"'])\{node\}")
_BOOLEANS: Final = {"true": True, "false": False}


@dataclass(frozen=True, eq=False)
class YamlScalar:
    """A single value."""

    value: Scalar
    line: int
    column: int


@dataclass(frozen=True, eq=False)
class YamlSequence:
    """A sequence."""

    items: "tuple[Part, ...]"
    line: int
    column: int


@dataclass(frozen=True, eq=False)
class YamlMapping:
    """A mapping: for each key its position and the value."""

    entries: "dict[str, tuple[YamlScalar, Part]]"
    line: int
    column: int

    def get(self, key: str) -> "Part | None":
        """The value of `key`, or None."""
        entry = self.entries.get(key)
        return None if entry is None else entry[1]


Part: TypeAlias = YamlScalar | YamlSequence | YamlMapping


def read_source(text: str, mistakes: Mistakes, bounds: Bounds = BOUNDS) -> Part | None:
    """Read one YAML document; duplicate keys are recorded as mistakes and omitted.

    Raises:
        PolicyRefused: not one document of the subset; other mistakes are then discarded.
    """
    try:
        return _Builder(events(text, bounds), mistakes).document()
    except YamlRefused as error:
        mistakes.found.clear()  # earlier mistakes may be wrong
        mistakes.add(error, str(error), _unquoted_own_name(text, error.line) or error.hint)
    return mistakes.raise_all()


def _unquoted_own_name(text: str, line: int) -> str:
    """What to write where `{node}/pose` has no quotes, and so begins a mapping of YAML."""
    lines = text.splitlines()[line - 1 : line] if line > 0 else []
    found = any(_UNQUOTED.search(each) for each in lines)
    return 'put own names in quotes: "{node}/pose", or write ~/pose' if found else ""


class _Builder:
    """Events to parts."""

    def __init__(self, events: Iterator[Any], mistakes: Mistakes) -> None:
        self._events = events
        self._mistakes = mistakes

    def document(self) -> Part | None:
        """The document, None if the text is empty; reads the whole text."""
        found = None
        for event in self._events:
            if isinstance(event, NodeEvent):
                found = self._part(event)
        return found

    def _part(self, event: Any) -> Part:
        if isinstance(event, ScalarEvent):
            return _scalar(event)
        line, column = position(event.start_mark)
        if isinstance(event, SequenceStartEvent):
            items = []
            while not isinstance(item := next(self._events), SequenceEndEvent):
                items.append(self._part(item))
            return YamlSequence(tuple(items), line, column)
        return YamlMapping(self._entries(), line, column)

    def _entries(self) -> dict[str, tuple[YamlScalar, Part]]:
        entries: dict[str, tuple[YamlScalar, Part]] = {}
        while not isinstance(event := next(self._events), MappingEndEvent):
            key = self._part(event)
            value = self._part(next(self._events))
            if not isinstance(key, YamlScalar):
                self._mistakes.add(key, "a key must be a scalar")
                continue
            name = str(key.value)
            if name in entries:
                first = f"{entries[name][0].line}:{entries[name][0].column}"
                hint = "keep one of them"
                self._mistakes.add(key, f"duplicate key {name!r}, first in {first}", hint)
                continue
            entries[name] = (key, value)
        return entries


def _scalar(event: Any) -> YamlScalar:
    value: Scalar = event.value if is_quoted(event) else _plain(event.value)
    return YamlScalar(value, *position(event.start_mark))


def _plain(text: str) -> Scalar:
    if text in _BOOLEANS:
        return _BOOLEANS[text]
    if _INT.fullmatch(text):
        return int(text)
    return float(text) if _FLOAT.fullmatch(text) else text
