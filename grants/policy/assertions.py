"""`tests` of a policy: what must stay true of it, read from the file; and messages made for trying filters.

Each assertion is about one node: what it `may` use, what it `may_not`, for what a person is asked (`asks`),
and how precisely it `sees` fields of topics. With `at`, times, the conditions of rules count as they are
then, for a `message` if one is given. `assertion_check` evaluates.
"""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, TypeAlias

from grants.conditions.compile import parse_timestamp
from grants.errors import ConditionRefused, MessageRefused
from grants.filters.layout import Array, Layout, Primitive, Struct, Text, Type
from grants.model import Right
from grants.policy import source
from grants.policy.model import EVERYONE, Subject, SubjectPattern
from grants.policy.rules import RIGHTS
from grants.policy.source import Mistakes, Part, YamlMapping, YamlScalar, suggest

Value: TypeAlias = int | float | str
_NANO: Final = 10**9


def leaves(layout: Layout) -> dict[str, Primitive | Text]:
    return dict(_leaves(layout.root, ""))


def below(paths: Mapping[str, Primitive | Text], path: str) -> list[str]:
    plain = path.replace("[*]", "")
    return [
        leaf
        for leaf in paths
        if leaf.replace("[*]", "") == plain or leaf.replace("[*]", "").startswith(f"{plain}.")
    ]


def serialize(layout: Layout, values: Mapping[str, Value]) -> bytes:
    return b"".join(_write(layout.root, "", values))


def read_back(layout: Layout, message: bytes) -> dict[str, Value | None]:
    """The values of all leaves; of an array the first, None if it is empty."""
    found: dict[str, Value | None] = {}
    try:
        end = _read(layout.root, "", message, 0, found)
    except (struct.error, UnicodeDecodeError) as error:
        raise MessageRefused("the message does not have its layout") from error
    if end != len(message):
        raise MessageRefused("the message does not end where its layout ends")
    return {path: found.get(path) for path in leaves(layout)}


def _leaves(kind: Type, path: str) -> Iterator[tuple[str, Primitive | Text]]:
    inner = kind.element if isinstance(kind, Array) else kind
    if isinstance(inner, Struct):
        here = f"{path}[*]." if isinstance(kind, Array) else f"{path}." if path else ""
        for name, member in inner.fields:
            yield from _leaves(member, here + name)
    elif not isinstance(inner, Array):
        yield path, inner


def _member(kind: Array | Struct, path: str, name: str = "") -> str:
    if isinstance(kind, Array):
        return f"{path}[*]" if isinstance(kind.element, Struct) else path
    return f"{path}.{name}" if path else name


def _write(kind: Type, path: str, values: Mapping[str, Value]) -> Iterator[bytes]:
    if isinstance(kind, Struct):
        for name, member in kind.fields:
            yield from _write(member, _member(kind, path, name), values)
    elif isinstance(kind, Array):
        count = 1 if kind.length is None else kind.length
        if kind.length is None:
            yield struct.pack("<I", count)
        yield b"".join(_write(kind.element, _member(kind, path), values)) * count
    elif isinstance(kind, Text):
        text = str(values.get(path, "")).encode()
        yield struct.pack("<I", len(text)) + text
    else:
        yield _packed(kind, values.get(path, 0))


def _count(data: bytes, at: int) -> int:
    return int(struct.unpack_from("<I", data, at)[0])


def _packed(kind: Primitive, value: Value) -> bytes:
    number = float(value) if kind.code in "fd" or len(kind.code) > 1 else int(value)
    if len(kind.code) == 2:  # time, duration
        return struct.pack(f"<{kind.code}", *divmod(round(number * _NANO), _NANO))
    return struct.pack(f"<{kind.code}", number)


def _read(kind: Type, path: str, data: bytes, at: int, found: dict[str, Value | None]) -> int:
    if isinstance(kind, Struct):
        for name, member in kind.fields:
            at = _read(member, _member(kind, path, name), data, at, found)
        return at
    if isinstance(kind, Array):
        count = kind.length
        if count is None:
            count, at = _count(data, at), at + 4
        for _ in range(min(count, len(data))):
            at = _read(kind.element, _member(kind, path), data, at, found)
        return at
    if isinstance(kind, Text):
        size = _count(data, at)
        found.setdefault(path, data[at + 4 : at + 4 + size].decode())
        return at + 4 + size
    numbers = struct.unpack_from(f"<{kind.code}", data, at)
    value = numbers[0] + numbers[1] / _NANO if len(numbers) == 2 else numbers[0]
    found.setdefault(path, value)
    return at + kind.size


_KEYS: Final = ("who", "may", "may_not", "asks", "sees", "at", "message")
EXACT: Final = "exact"
NOTHING: Final = "no"
_LIMITS: Final = f"a number (no finer than that), {NOTHING} or {EXACT}"

Limit: TypeAlias = float | str
"""Seen no finer than this; or `no`, not at all; or `exact`, as it is; or a level of a word."""


class Says(StrEnum):
    MAY = "may"
    MAY_NOT = "may_not"
    ASKS = "asks"


@dataclass(frozen=True)
class Claim:
    says: Says
    right: Right
    name: str
    line: int


@dataclass(frozen=True)
class SeenField:
    topic: str
    path: str
    limit: Limit
    line: int


@dataclass(frozen=True)
class Assertion:
    """One item of `tests`.

    Args:
        subject: the node; of an identity that is a pattern, one that it covers.
        at: seconds since the epoch; none: conditions are not evaluated.
        message: values by path, for conditions on messages.
        pattern: the nodes it is about, if it is about an identity that is a pattern.
    """

    subject: Subject
    claims: tuple[Claim, ...] = ()
    seen: tuple[SeenField, ...] = ()
    at: tuple[int, ...] = ()
    message: Mapping[str, Value] = field(default_factory=dict)
    line: int = 0
    pattern: str = ""


def read_tests(
    part: Part | None,
    identities: Mapping[str, SubjectPattern],
    groups: Mapping[str, tuple[SubjectPattern, ...]],
    mistakes: Mistakes,
) -> tuple[Assertion, ...]:
    named = {name: (who,) for name, who in identities.items()}
    reader = _Reader({**named, **groups}, mistakes)
    return tuple(each for item in source.items(part) for each in reader.read(item))


class _Reader:
    def __init__(self, named: Mapping[str, tuple[SubjectPattern, ...]], mistakes: Mistakes) -> None:
        self._named = named
        self._mistakes = mistakes

    def read(self, part: Part) -> list[Assertion]:
        mapping = source.mapping(part, "a test", self._mistakes)
        if mapping is None:
            return []
        source.check_keys(mapping, "a test", _KEYS, ("who",), self._mistakes)
        subjects = self._subjects(mapping.get("who"))
        claims = [claim for says in Says for claim in self._claims(mapping.get(says.value), says)]
        seen = self._seen(mapping.get("sees"), claims)
        at = tuple(self._times(mapping.get("at")))
        message = mapping.get("message")
        if not claims and not seen:
            self._mistakes.add(mapping, "a test that tests nothing", "add may, may_not or sees")
        if message is not None and not at:
            self._mistakes.add(message, "message needs at: conditions may read the time", "add at")
        values = self._message(message)
        return [
            Assertion(subject, tuple(claims), tuple(seen), at, values, mapping.line, pattern)
            for subject, pattern in subjects
        ]

    def _subjects(self, part: Part | None) -> list[tuple[Subject, str]]:
        label = source.text(part, "who", self._mistakes)
        if label is None or part is None:
            return []
        if label in self._named:
            found = self._named[label]
            return [(who.sample, who.node if who.node and "*" in who.node else "") for who in found]
        if not (label.startswith("/") or ":" in label) or "*" in label or label == EVERYONE:
            hint = suggest(label, self._named) if self._named else "for example /heating"
            self._mistakes.add(part, f"not a node, identity or group: {label[:60]!r}", hint)
            return []
        name = source.subject(part, "who", self._mistakes)
        return [] if name is None else [(Subject(name, bytes(32)), "")]

    def _claims(self, part: Part | None, says: Says) -> list[Claim]:
        rights = source.mapping(part, says.value, self._mistakes)
        found: list[Claim] = []
        for label, (key, value) in rights.entries.items() if rights is not None else ():
            if label not in RIGHTS:
                message = f"unknown right {label[:60]!r} in {says.value}"
                self._mistakes.add(key, message, suggest(label, RIGHTS))
                continue
            for item in source.items(value):
                name = source.own_pattern(item, label, RIGHTS[label], self._mistakes)
                if name is not None:
                    found.append(Claim(says, RIGHTS[label], name, item.line))
        return found

    def _seen(self, part: Part | None, claims: list[Claim]) -> list[SeenField]:
        topics = source.mapping(part, "sees", self._mistakes)
        found: list[SeenField] = []
        for key, value in topics.entries.values() if topics is not None else ():
            topic = source.own_pattern(key, "sees", Right.SUBSCRIBE, self._mistakes)
            if topic is None:
                continue
            if isinstance(value, YamlScalar) and value.value == NOTHING:
                claims.append(Claim(Says.MAY_NOT, Right.SUBSCRIBE, topic, key.line))
                continue
            fields = source.mapping(value, f"sees {topic}", self._mistakes)
            for path, (at, limit) in fields.entries.items() if fields is not None else ():
                read = self._limit(limit)
                if read is not None:
                    found.append(SeenField(topic, path, read, at.line))
        return found

    def _limit(self, part: Part) -> Limit | None:
        value = part.value if isinstance(part, YamlScalar) else None
        if isinstance(value, str):
            return value
        if isinstance(value, int | float) and not isinstance(value, bool) and value > 0:
            return float(value)
        self._mistakes.add(part, "how a field is seen is said otherwise", f"write {_LIMITS}")
        return None

    def _times(self, part: Part | None) -> list[int]:
        found: list[int] = []
        for item in source.items(part):
            text = source.text(item, "at", self._mistakes) or "?"
            try:
                found.append(parse_timestamp(text))
            except ConditionRefused as error:
                if text != "?":
                    self._mistakes.add(item, str(error), error.hint)
        return found

    def _message(self, part: Part | None) -> dict[str, Value]:
        first: dict[str, YamlScalar] = {}
        for path, value in self._values(part, ""):
            if path in first:
                source.again(value, f"message: {path[:80]!r}", first[path], self._mistakes)
            first.setdefault(path, value)
        return {path: value.value for path, value in first.items()}

    def _values(self, part: Part | None, path: str) -> list[tuple[str, YamlScalar]]:
        if isinstance(part, YamlScalar) and path:
            return [(path, part)]
        mapping = source.mapping(part, path or "message", self._mistakes)
        entries = mapping.entries.items() if isinstance(mapping, YamlMapping) else ()
        return [
            value
            for name, (_, inner) in entries
            for value in self._values(inner, f"{path}.{name}" if path else name)
        ]
