"""From YAML text to a tree in which every part has its position. The only YAML reader.

Readers of a part record a mistake if it is something else and return None; reading goes on, so that all
mistakes are reported at once. A file with one is refused: a `Policy` never has any.
"""

import base64
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Final, NoReturn, TypeAlias

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

from ca.errors import NameRefused
from ca.names import closest, is_alias, local_pattern
from grants.errors import PolicyRefused, YamlRefused
from grants.model import MAX_RATE, Right, Scalar
from grants.policy.names import NODE, check_rule_pattern, has_partial_star

_BEGINS: Final = MappingStartEvent | SequenceStartEvent
_ENDS: Final = MappingEndEvent | SequenceEndEvent
_QUOTED: Final = ("'", '"', "|", ">")
_CORE_TAG: Final = "tag:yaml.org,2002:"
_INT: Final = re.compile(r"[-+]?[0-9]{1,20}|0x[0-9a-fA-F]{1,16}|0o[0-7]{1,22}", re.ASCII)
_FLOAT: Final = re.compile(
    r"[-+]?(?:[0-9]{1,400}\.[0-9]{0,400}|\.[0-9]{1,400}|[0-9]{1,400})(?:[eE][-+]?[0-9]{1,3})?", re.ASCII
)
_KEYWORDS: Final[dict[str, object]] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), math.nan),
    **{sign + value: float(f"{sign}inf") for sign in ("", "+", "-") for value in (".inf", ".Inf", ".INF")},
}
_SURROGATES: Final = re.compile("[\ud800-\udfff]")  # an escape of YAML may say them
_TIME: Final = re.compile(r"[0-9]{4}-[0-9]{2}-[0-9]{2}[T ][0-9]{2}:[0-9]{2}:[0-9]{2}", re.ASCII)
_KINDS: Final = {"binary": bytes, "str": str, "int": int, "float": float, "bool": bool, "null": type(None)}


@dataclass(frozen=True)
class Bounds:
    """How much YAML is read: characters of the text, levels of nesting, events of the parser."""

    size: int = 4 * 1024 * 1024
    depth: int = 16
    events: int = 300_000  # a few seconds of work; a rule of a policy has 30


BOUNDS: Final = Bounds()  # 10,000 rules of 400 characters and 30 events
MAX_SIZE: Final = BOUNDS.size
MAX_MISTAKES: Final = 200  # more are not useful, and a hostile file must not cause a long report
_MAX_SUGGESTIONS: Final = 12


# The cost of YAML is in its structure, not in its bytes: an alias stands for a tree, a merge for another map.
# So the size is checked before parsing, and anchors, aliases, tags, directives, further documents, depth and
# the number of events with each event, before a value is built.
def events(text: str, bounds: Bounds, *, tags: bool = False) -> Iterator[Any]:
    if len(text) > bounds.size:
        raise YamlRefused(f"{len(text)} characters where at most {bounds.size} are allowed")
    depth = documents = 0
    try:
        for number, event in enumerate(YAML(typ="safe", pure=True).parse(text)):
            documents += isinstance(event, DocumentStartEvent)
            depth += isinstance(event, _BEGINS)
            depth -= isinstance(event, _ENDS)
            problem = _unsupported(event, tags=tags)
            if not problem and depth > bounds.depth:
                problem = f"nested deeper than {bounds.depth}"
            elif not problem and number > bounds.events:
                problem = f"more than {bounds.events} YAML events"
            elif not problem and documents > 1:
                problem = "more than one document"
            if problem:
                _refuse(event, problem, "write it without this feature, or in a smaller file")
            yield event
    except MarkedYAMLError as error:
        raise YamlRefused(
            f"not YAML: {error.problem or error.context}",
            _remedy(error.problem or ""),
            *position(error.problem_mark or error.context_mark),
        ) from error
    except (YAMLError, RecursionError, ValueError) as error:
        raise YamlRefused(f"not YAML: {str(error).splitlines()[0]}") from error


def _remedy(problem: str) -> str:
    if "'\\t'" in problem:
        return "indent with spaces: YAML allows no tabs"
    if problem.startswith("expected alphabetic or numeric character"):
        return 'put text that begins with * or & in quotes: "*"'
    if "mapping values are not allowed" in problem or "got ':'" in problem:
        return "check the indentation, and put text with a colon in quotes"
    return "check the indentation"


def load_yaml(text: str, bounds: Bounds | None = None) -> object:
    """The value of one document: dicts, lists, and the scalars of YAML 1.2's core schema.

    A date with a time (`2026-01-02 03:04:05`) is a datetime, since XML-RPC has them; an
    invalid date stays a text. The tags `!!str`, `!!int`, `!!float`, `!!bool`, `!!null` and
    `!!binary` are accepted if the text is a value of that type.
    """
    stream = events(text, bounds or BOUNDS, tags=True)
    found = None
    for event in stream:  # to the end: a second document is refused there
        if isinstance(event, NodeEvent):
            found = _value(event, stream)
    return found


def _value(event: Any, stream: Iterator[Any]) -> object:
    if isinstance(event, ScalarEvent):
        return _scalar(event)
    if isinstance(event, SequenceStartEvent):
        items = []
        while not isinstance(after := next(stream), SequenceEndEvent):
            items.append(_value(after, stream))
        return items
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
    if kind == "str" or (kind is None and event.style in _QUOTED):
        return text
    value = _plain(text)
    if kind == "binary":
        value = None
        with suppress(ValueError):
            value = base64.b64decode("".join(text.split()), validate=True)
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


def _tag(event: Any) -> str | None:
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


def position(mark: Any) -> tuple[int, int]:
    return (1, 1) if mark is None else (mark.line + 1, mark.column + 1)


def _refuse(event: Any, problem: str, hint: str = "") -> NoReturn:
    raise YamlRefused(problem, hint, *position(event.start_mark))


@dataclass(frozen=True, order=True)
class Mistake:
    """One mistake, in the form editors jump to: `file:line:column: message`."""

    line: int
    column: int
    message: str
    hint: str
    file: str = ""

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}: {self.message}"


@dataclass
class Mistakes:
    """Collects the mistakes of one file."""

    file: str
    found: list[Mistake] = field(default_factory=list)

    def add(self, line: int, column: int, message: str, hint: str = "") -> None:
        self.found.append(Mistake(line, column, message, hint, self.file))
        if len(self.found) >= MAX_MISTAKES:
            self.raise_all()

    def raise_if_any(self) -> None:
        """Raise `PolicyRefused` with all mistakes, in the order of the file, if there are any."""
        if self.found:
            self.raise_all()

    def raise_all(self) -> NoReturn:
        """Raise `PolicyRefused` with all mistakes so far, at least one."""
        ordered = tuple(sorted(set(self.found)))
        more = f" (and {len(ordered) - 1} more, see: rossec policy check {self.file})"
        rest = more if len(ordered) > 1 else ""
        raise PolicyRefused(f"{ordered[0]}{rest}", ordered[0].hint, ordered)


def suggest(value: str, known: Iterable[str]) -> str:
    """A hint: the most similar known value, or a list of them."""
    values = sorted({str(each) for each in known})  # members of a StrEnum as what is written
    if (close := closest(value, values)) is not None:
        return f"did you mean {close!r}?"
    if not values:
        return "none is defined"
    more = ", ..." if len(values) > _MAX_SUGGESTIONS else ""
    return f"expected one of {', '.join(values[:_MAX_SUGGESTIONS])}{more}"


_SOURCE_INT: Final = re.compile(r"[-+]?[0-9]{1,18}", re.ASCII)
_SOURCE_FLOAT: Final = re.compile(
    r"[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+|[0-9]+)(?:[eE][-+]?[0-9]{1,3})?", re.ASCII
)
_UNQUOTED: Final = re.compile(r"(?<![\"'])\{node\}")
_BOOLEANS: Final = {"true": True, "false": False}


# A part knows where it stands and who collects the mistakes of its file, so that a reader of it needs nothing
# else; without a collector none can be made, as else a mistake might be recorded nowhere.
@dataclass(frozen=True, eq=False)
class _Placed:
    line: int
    column: int
    mistakes: Mistakes = field(repr=False)

    def mistake(self, message: str, hint: str = "") -> None:
        self.mistakes.add(self.line, self.column, message, hint)


@dataclass(frozen=True, eq=False)
class YamlScalar(_Placed):
    value: Scalar


@dataclass(frozen=True, eq=False)
class YamlSequence(_Placed):
    items: "tuple[Part, ...]"


@dataclass(frozen=True, eq=False)
class YamlMapping(_Placed):
    entries: "dict[str, tuple[YamlScalar, Part]]"

    def get(self, key: str) -> "Part | None":
        entry = self.entries.get(key)
        return None if entry is None else entry[1]


Part: TypeAlias = YamlScalar | YamlSequence | YamlMapping


def read_source(text: str, mistakes: Mistakes, bounds: Bounds = BOUNDS) -> Part | None:
    """Read one YAML document; duplicate keys are recorded as mistakes and omitted."""
    found = None
    try:
        builder = _Builder(events(text, bounds), mistakes)
        for event in builder.events:  # to the end: a second document is refused there
            if isinstance(event, NodeEvent):
                found = builder.part(event)
    except YamlRefused as error:
        mistakes.found.clear()  # earlier mistakes may be wrong
        # `{node}/pose` without quotes begins a mapping of YAML.
        lines = text.splitlines()[error.line - 1 : error.line] if error.line > 0 else []
        own = any(_UNQUOTED.search(each) for each in lines)
        hint = 'put own names in quotes: "{node}/pose", or write ~/pose' if own else error.hint
        mistakes.add(error.line, error.column, str(error), hint)
        mistakes.raise_all()
    return found


@dataclass
class _Builder:
    events: Iterator[Any]
    mistakes: Mistakes

    def part(self, event: Any) -> Part:
        at = (*position(event.start_mark), self.mistakes)
        if isinstance(event, ScalarEvent):
            plain: Scalar = event.value if event.style in _QUOTED else _plain_scalar(event.value)
            return YamlScalar(*at, plain)
        if isinstance(event, SequenceStartEvent):
            items = []
            while not isinstance(item := next(self.events), SequenceEndEvent):
                items.append(self.part(item))
            return YamlSequence(*at, tuple(items))
        entries: dict[str, tuple[YamlScalar, Part]] = {}
        while not isinstance(after := next(self.events), MappingEndEvent):
            key, value = self.part(after), self.part(next(self.events))
            if not isinstance(key, YamlScalar):
                key.mistake("a key must be a scalar")
            elif (name := str(key.value)) in entries:  # the second would win without a word
                first = f"{entries[name][0].line}:{entries[name][0].column}"
                key.mistake(f"duplicate key {name!r}, first in {first}", "keep one of them")
            else:
                entries[name] = (key, value)
        return YamlMapping(*at, entries)


# Texts, unless they are clearly a number or true/false: `22:00`, `no`, `2026-11-20` stay as written.
def _plain_scalar(text: str) -> Scalar:
    if text in _BOOLEANS:
        return _BOOLEANS[text]
    if _SOURCE_INT.fullmatch(text):
        return int(text)
    return float(text) if _SOURCE_FLOAT.fullmatch(text) else text


_UNITS: Final = {"s": 1, "m": 60, "h": 3600, "d": 86400, "w": 7 * 86400}
_DURATION: Final = re.compile(r"([1-9][0-9]{0,5})([smhdw])", re.ASCII)
_KEY: Final = re.compile(r"sha256:([0-9a-f]{64})", re.ASCII)
_PARTIAL_STAR: Final = (
    "* stands for a whole segment: list the nodes, or groups: {robots: [/robot1, /robot2]};"
    " anonymous nodes, /rviz_..., are one identity: /rviz"
)
_MAX_TEXT: Final = 1000


def mapping(part: Part | None, what: str) -> YamlMapping | None:
    """A mapping; a missing one is None and no mistake."""
    if part is None or isinstance(part, YamlMapping):
        return part
    part.mistake(f"{what} must be a mapping", "write key: value")
    return None


def check_keys(part: YamlMapping, what: str, known: Collection[str], required: Collection[str]) -> None:
    """Record every unknown key, and every required one that is missing.

    `required` may be a mapping: to what is to be added for each.
    """
    for name, (key, _) in part.entries.items():
        if name not in known:
            key.mistake(f"unknown key {name[:60]!r} in {what}", suggest(name, known))
    for name in required:
        if name not in part.entries:
            example = required[name] if isinstance(required, Mapping) else f"{name}: ..."
            part.mistake(f"{what} has no {name!r}", f"add {example}")


def entries(part: Part | None, what: str) -> Iterator[tuple[str, YamlScalar, Part]]:
    """Name, key and value of each entry of a mapping; none of a missing one."""
    found = mapping(part, what)
    for name, (key, value) in found.entries.items() if found is not None else ():
        yield name, key, value


def by_name(
    part: Part | None, what: str, read: Callable[[YamlScalar], str | None]
) -> Iterator[tuple[str, YamlScalar, Part]]:
    """As `entries`, by what `read` makes of the keys: None if a key is a mistake.

    Keys of several spellings (`~/pose` and `"{node}/pose"`) are equal only then; the second of two
    would win without a word, so it is a mistake.
    """
    first: dict[str, YamlScalar] = {}
    for _, key, value in entries(part, what):
        name = read(key)
        if name is not None and name in first:
            again(key, f"{what}: {name[:80]!r}", first[name])
        elif name is not None:
            first[name] = key
            yield name, key, value


def by_topic(
    part: YamlMapping, what: str, rule: str, topics: Collection[str], right: Right
) -> dict[str, tuple[YamlScalar, YamlMapping]]:
    """What a rule says for some of its topics, `filter` or `see`: a mapping for each."""
    found: dict[str, tuple[YamlScalar, YamlMapping]] = {}
    of_rule = f"{what} of rule {rule}"
    for topic, key, value in by_name(part, of_rule, lambda key: pattern(key, of_rule)):
        inner = mapping(value, f"{what} of {topic}")
        if topic not in topics:
            key.mistake(f"rule {rule} has no {right.label} right on {topic[:80]!r}", suggest(topic, topics))
        elif inner is not None:
            found[topic] = (key, inner)
    return found


def again(key: Part, what: str, first: Part) -> None:
    key.mistake(f"{what} a second time, first in {first.line}:{first.column}", "keep one of them")


def text(part: Part | None, what: str) -> str | None:
    if part is None:
        return None
    if isinstance(part, YamlScalar) and isinstance(part.value, str) and 0 < len(part.value) <= _MAX_TEXT:
        return part.value
    part.mistake(f"{what} must be text of 1 to {_MAX_TEXT} characters", "put it in quotes")
    return None


def items(part: Part | None) -> tuple[Part, ...]:
    if part is None:
        return ()
    return part.items if isinstance(part, YamlSequence) else (part,)


def duration(part: Part | None, what: str, *, never: bool = False) -> int | None:
    """Seconds of `30s`, `15m`, `8h`, `7d`, `4w`; 0 for `never` if allowed."""
    if part is None:
        return None
    value = part.value if isinstance(part, YamlScalar) else None
    if never and value == "never":
        return 0
    match = _DURATION.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        choice = "write 30s, 15m, 8h, 7d or 4w" + (", or never" if never else "")
        part.mistake(f"{what} is not a duration{_quoted(value)}", choice)
        return None
    return int(match[1]) * _UNITS[match[2]]


def pattern(part: Part | None, what: str) -> str | None:
    if isinstance(part, YamlMapping) and list(part.entries) == [NODE[1:-1]]:
        part.mistake(f"{what}: {NODE} without quotes", f'put it in quotes: "{NODE}"')
        return None
    value = text(part, what)
    if value is None or part is None:
        return None
    try:
        return check_rule_pattern(value)
    except NameRefused as error:
        part.mistake(f"{what}: {error}", error.hint)
        return None


def own_pattern(part: Part | None, what: str, right: Right) -> str | None:
    value = part.value if isinstance(part, YamlScalar) else None
    said = value if isinstance(value, str) and len(value) <= _MAX_TEXT else ""
    if part is not None and (":" in said or (is_alias(said) and right is not Right.GRAPH)):
        hint = "its own authority grants rights on it, by its name there"
        part.mistake(f"{what}: {said[:80]!r} is a name of another domain", hint)
        return None
    return pattern(part, what)


def subject(part: Part | None, what: str) -> str | None:
    value = text(part, what)
    if value is None or part is None:
        return None
    if is_alias(value):
        hint = "LABEL:/NAME, for example hospital:/rounds/*"
        part.mistake(f"{what}: write {value[:80]!r} with the label of the domain", hint)
        return None
    try:
        return local_pattern(value)
    except NameRefused as error:
        hint = _PARTIAL_STAR if has_partial_star(value) else error.hint or "LABEL:/NAME"
        part.mistake(f"{what}: {error}", hint)
        return None


def key(part: Part | None) -> bytes | None:
    if part is None:
        return None
    value = part.value if isinstance(part, YamlScalar) else None
    match = _KEY.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        hint = "write sha256: and 64 hexadecimal digits, see: rossec ca show --json"
        part.mistake(f"not a key thumbprint{_quoted(value)}", hint)
        return None
    return bytes.fromhex(match[1])


def number(part: Part | None, what: str) -> float | None:
    if part is None:
        return None
    value = part.value if isinstance(part, YamlScalar) else None
    if isinstance(value, int | float) and not isinstance(value, bool) and 0 < value <= MAX_RATE:
        return value
    part.mistake(f"{what} must be a number above zero{_quoted(value)}", "for example 0.2")
    return None


def choice(part: Part | None, what: str, known: Collection[str]) -> str | None:
    if part is None:
        return None
    value = str(part.value) if isinstance(part, YamlScalar) else ""
    if value in known:
        return value
    part.mistake(f"unknown {what}{_quoted(value)}", suggest(value, known))
    return None


def _quoted(value: object) -> str:
    return "" if value is None or value == "" else f": {str(value)[:60]!r}"
