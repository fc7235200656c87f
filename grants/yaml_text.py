"""The only YAML reader: a stream of events, bounded before and while the text is parsed.

The cost of YAML is in its structure, not in its bytes: an alias stands for a tree, a bracket for a
level that the scanner checks with each token, a merge for another map. So the size is checked
before parsing; anchors, aliases, tags outside the core schema, directives, further documents,
depth and the number of events are checked with each event. No value is built before its event was
checked. A merge key `<<` is an ordinary key. Pure.
"""

import base64
import math
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final, NoReturn

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

from grants.errors import YamlRefused

_BEGINS: Final = MappingStartEvent | SequenceStartEvent
_ENDS: Final = MappingEndEvent | SequenceEndEvent
_QUOTED: Final = ("'", '"', "|", ">")
_CORE_TAG: Final = "tag:yaml.org,2002:"
_INT: Final = re.compile(r"[-+]?[0-9]{1,20}|0x[0-9a-fA-F]{1,16}|0o[0-7]{1,22}", re.ASCII)
_FLOAT: Final = re.compile(
    r"[-+]?(?:[0-9]{1,400}\.[0-9]{0,400}|\.[0-9]{1,400}|[0-9]{1,400})(?:[eE][-+]?[0-9]{1,3})?",
    re.ASCII,
)
_KEYWORDS: Final[dict[str, object]] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), math.nan),
    **{sign + value: float(f"{sign}inf")
       for sign in ("", "+", "-") for value in (".inf", ".Inf", ".INF")},
}  # fmt: skip
_SURROGATES: Final = re.compile("[\ud800-\udfff]")  # an escape of YAML may say them
_TIME: Final = re.compile(r"[0-9]{4}-[0-9]{2}-[0-9]{2}[T ][0-9]{2}:[0-9]{2}:[0-9]{2}", re.ASCII)
_KINDS: Final = {
    "binary": bytes,
    "str": str,
    "int": int,
    "float": float,
    "bool": bool,
    "null": type(None),
}


@dataclass(frozen=True)
class Bounds:
    """How much YAML is read: characters of the text, levels of nesting, events of the parser."""

    size: int = 4 * 1024 * 1024
    depth: int = 16
    events: int = 300_000  # a few seconds of work; a rule of a policy has 30


def events(text: str, bounds: Bounds, *, tags: bool = False) -> Iterator[Any]:
    """The events of the one document in `text`; with `tags`, scalars may have the tags of `load`.

    Raises:
        YamlRefused: not YAML, beyond the bounds, or outside the subset; with its position.
    """
    if len(text) > bounds.size:
        raise YamlRefused(f"{len(text)} characters where at most {bounds.size} are allowed")
    depth = documents = 0
    try:
        for number, event in enumerate(YAML(typ="safe", pure=True).parse(text)):
            documents += isinstance(event, DocumentStartEvent)
            depth += isinstance(event, _BEGINS)
            depth -= isinstance(event, _ENDS)
            problem = _unsupported(event, tags=tags) or _over_limit(
                depth, documents, number, bounds
            )
            if problem:
                raise YamlRefused(
                    problem,
                    "write it without this feature, or in a smaller file",
                    *position(event.start_mark),
                )
            yield event
    except MarkedYAMLError as error:
        raise YamlRefused(
            f"not YAML: {error.problem or error.context}", _remedy(error.problem or ""),
            *position(error.problem_mark or error.context_mark),
        ) from error  # fmt: skip
    except (YAMLError, RecursionError, ValueError) as error:
        raise YamlRefused(f"not YAML: {str(error).splitlines()[0]}") from error


def _remedy(problem: str) -> str:
    """What to do about what the parser says, for the mistakes that people make most."""
    if "'\\t'" in problem:
        return "indent with spaces: YAML allows no tabs"
    if problem.startswith("expected alphabetic or numeric character"):
        return 'put text that begins with * or & in quotes: "*"'
    if "mapping values are not allowed" in problem or "got ':'" in problem:
        return "check the indentation, and put text with a colon in quotes"
    return "check the indentation"


def load(text: str, bounds: Bounds | None = None) -> object:
    """The value of one document: dicts, lists, and the scalars of YAML 1.2's core schema.

    A date with a time (`2026-01-02 03:04:05`) is a datetime, since XML-RPC has them; an
    invalid date stays a text. The tags `!!str`, `!!int`, `!!float`, `!!bool`, `!!null` and
    `!!binary` are accepted if the text is a value of that type.

    Raises:
        YamlRefused: as for `events`; a key that is not a scalar, or a duplicate key.
    """
    stream = events(text, bounds or Bounds(), tags=True)
    found = None
    for event in stream:  # to the end: a second document is refused there
        if isinstance(event, NodeEvent):
            found = _value(event, stream)
    return found


def is_quoted(event: Any) -> bool:
    """Whether a scalar is quoted, so always text."""
    return event.style in _QUOTED


def _value(event: Any, stream: Iterator[Any]) -> object:
    if isinstance(event, ScalarEvent):
        return _scalar(event)
    if isinstance(event, SequenceStartEvent):
        items = []
        while not isinstance(after := next(stream), SequenceEndEvent):
            items.append(_value(after, stream))
        return items
    return _mapping(stream)


def _mapping(stream: Iterator[Any]) -> dict[object, object]:
    found: dict[object, object] = {}
    while not isinstance(event := next(stream), MappingEndEvent):
        if not isinstance(event, ScalarEvent):
            _refuse(event, "a key must be a scalar")
        key = _scalar(event)
        if key in found:
            _refuse(event, f"duplicate key {str(key)[:60]!r}", "keep one of them")
        found[key] = _value(next(stream), stream)
    return found


def _scalar(event: Any) -> object:
    kind, text = _tag(event), str(event.value)
    if kind == "str" or (kind is None and is_quoted(event)):
        return text
    value = _bytes(text) if kind == "binary" else _plain(text)
    if kind == "float" and type(value) is int:
        return float(value)
    if kind is not None and type(value) is not _KINDS[kind]:
        _refuse(event, f"{text[:60]!r} is not a valid {kind}")
    return value


def _plain(text: str) -> object:
    if text in _KEYWORDS:
        return _KEYWORDS[text]
    if _INT.fullmatch(text):
        return int(text, 0) if text.startswith(("0x", "0o")) else int(text)
    if _TIME.fullmatch(text):
        with suppress(ValueError):  # the 30th of February
            return datetime.fromisoformat(text)
    return float(text) if _FLOAT.fullmatch(text) else text


def _bytes(text: str) -> bytes | None:
    with suppress(ValueError):
        return base64.b64decode("".join(text.split()), validate=True)
    return None


def _tag(event: Any) -> str | None:
    """The core schema type in the tag of a scalar."""
    tag = None if event.ctag is None else str(event.ctag)
    return None if tag in (None, "!") else str(tag).removeprefix(_CORE_TAG)


def _unsupported(event: Any, *, tags: bool) -> str:
    if isinstance(event, DocumentStartEvent):
        return "directives are not allowed" if event.version or event.tags else ""
    if isinstance(event, AliasEvent) or (isinstance(event, NodeEvent) and event.anchor):
        return "anchors and aliases are not allowed"
    if not isinstance(event, NodeEvent):
        return ""
    if isinstance(event, ScalarEvent) and _SURROGATES.search(event.value):
        return "a text is not Unicode: it has half a pair of surrogates"
    kind = _tag(event)
    if kind is None or (tags and isinstance(event, ScalarEvent) and kind in _KINDS):
        return ""
    return "tags are not allowed"


def _over_limit(depth: int, documents: int, number: int, bounds: Bounds) -> str:
    if depth > bounds.depth:
        return f"nested deeper than {bounds.depth}"
    if number > bounds.events:
        return f"more than {bounds.events} YAML events"
    return "more than one document" if documents > 1 else ""


def position(mark: Any) -> tuple[int, int]:
    """Line and column of a mark, from 1."""
    return (1, 1) if mark is None else (mark.line + 1, mark.column + 1)


def _refuse(event: Any, problem: str, hint: str = "") -> NoReturn:
    raise YamlRefused(problem, hint, *position(event.start_mark))
