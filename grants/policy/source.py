"""From YAML text to a tree in which every part knows its line. YAML 1.2, and less than all of it.

The size is checked before the parser sees the text. Anchors, aliases, tags, directives and
further documents are refused while parsing (an alias bomb never grows), duplicate keys while
building: in a policy the second of two equal keys would silently win. Words are texts unless
they are plainly a number or true/false: `22:00`, `no` and `2026-11-20` stay what was written.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    DocumentStartEvent,
    MappingEndEvent,
    MappingStartEvent,
    NodeEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
)

from grants.model import Scalar
from grants.policy.mistakes import Mistakes

MAX_SIZE: Final = 4 * 1024 * 1024  # characters: 10,000 rules of 400
MAX_DEPTH: Final = 16

_INT: Final = re.compile(r"[-+]?[0-9]{1,18}", re.ASCII)
_FLOAT: Final = re.compile(
    r"[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+|[0-9]+)(?:[eE][-+]?[0-9]{1,3})?", re.ASCII
)
_TRUTH: Final = {"true": True, "false": False}


@dataclass(frozen=True, eq=False)
class Word:
    """A single value."""

    value: Scalar
    line: int
    column: int


@dataclass(frozen=True, eq=False)
class Row:
    """A sequence."""

    items: "tuple[Part, ...]"
    line: int
    column: int


@dataclass(frozen=True, eq=False)
class Table:
    """A mapping: by key, the key's own place and the value."""

    entries: "dict[str, tuple[Word, Part]]"
    line: int
    column: int

    def get(self, key: str) -> "Part | None":
        """The value of `key`, or None."""
        entry = self.entries.get(key)
        return None if entry is None else entry[1]


Part: TypeAlias = Word | Row | Table


@dataclass(frozen=True)
class _Start:
    line: int = 1
    column: int = 1


def read_source(text: str, mistakes: Mistakes) -> Part | None:
    """Read one YAML document; duplicate keys are noted and left out.

    Raises:
        PolicyRefused: not one document of the subset; what was read so far means nothing.
    """
    if len(text) > MAX_SIZE:
        mistakes.add(_Start(), f"{len(text)} characters where at most {MAX_SIZE} are allowed")
        mistakes.refuse_any()
    try:
        events = _checked(text, mistakes)
        mistakes.refuse_any()
        return _Builder(iter(events), mistakes).document()
    except MarkedYAMLError as error:
        place = _place(error.problem_mark or error.context_mark)
        mistakes.add(place, f"not YAML: {error.problem or error.context}", "check the indentation")
    except (YAMLError, RecursionError, ValueError) as error:
        mistakes.add(_Start(), f"not YAML: {str(error).splitlines()[0]}")
    return mistakes.refuse()


def _place(mark: Any) -> _Start:
    return _Start() if mark is None else _Start(mark.line + 1, mark.column + 1)


def _checked(text: str, mistakes: Mistakes) -> list[Any]:
    """All events; stops at the first that is outside the subset."""
    events: list[Any] = []
    depth = documents = 0
    for event in YAML(typ="rt", pure=True).parse(text):
        documents += isinstance(event, DocumentStartEvent)
        depth += isinstance(event, MappingStartEvent | SequenceStartEvent)
        depth -= isinstance(event, MappingEndEvent | SequenceEndEvent)
        problem = _outside(event) or _beyond(depth, documents)
        if problem:
            mistakes.add(_place(event.start_mark), problem, "write it out, plainly")
            break
        events.append(event)
    return events


def _outside(event: Any) -> str:
    if isinstance(event, DocumentStartEvent):
        return "directives are not allowed" if event.version or event.tags else ""
    if isinstance(event, AliasEvent) or (isinstance(event, NodeEvent) and event.anchor):
        return "anchors and aliases are not allowed"
    if getattr(event, "ctag", None) is not None and event.tag not in (None, "!"):
        return "tags are not allowed"
    return ""


def _beyond(depth: int, documents: int) -> str:
    if depth > MAX_DEPTH:
        return f"nested deeper than {MAX_DEPTH}"
    return "a second document" if documents > 1 else ""


class _Builder:
    """Events to parts."""

    def __init__(self, events: Iterator[Any], mistakes: Mistakes) -> None:
        self._events = events
        self._mistakes = mistakes

    def document(self) -> Part | None:
        """The one document, None when there is none."""
        for event in self._events:
            if isinstance(event, NodeEvent):
                return self._part(event)
        return None

    def _part(self, event: Any) -> Part:
        if isinstance(event, ScalarEvent):
            return _word(event)
        place = _place(event.start_mark)
        if isinstance(event, SequenceStartEvent):
            items = []
            while not isinstance(after := next(self._events), SequenceEndEvent):
                items.append(self._part(after))
            return Row(tuple(items), place.line, place.column)
        return Table(self._entries(), place.line, place.column)

    def _entries(self) -> dict[str, tuple[Word, Part]]:
        entries: dict[str, tuple[Word, Part]] = {}
        while not isinstance(event := next(self._events), MappingEndEvent):
            key = self._part(event)
            value = self._part(next(self._events))
            if not isinstance(key, Word):
                self._mistakes.add(key, "a key must be a word")
                continue
            name = str(key.value)
            if name in entries:
                first = entries[name][0].line
                hint = "keep one of them; which would count is not for the parser to choose"
                self._mistakes.add(key, f"{name!r} again: it stands in line {first} already", hint)
                continue
            entries[name] = (key, value)
        return entries


def _word(event: Any) -> Word:
    place = _place(event.start_mark)
    quoted = event.style in ("'", '"', "|", ">")
    value: Scalar = event.value if quoted else _plain(event.value)
    return Word(value, place.line, place.column)


def _plain(text: str) -> Scalar:
    if text in _TRUTH:
        return _TRUTH[text]
    if _INT.fullmatch(text):
        return int(text)
    return float(text) if _FLOAT.fullmatch(text) else text
