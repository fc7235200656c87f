"""`tests` of a policy: what must stay true of it, read from the file; and messages made for trying filters.

Each assertion is about one node: what it `may` use, what it `may_not`, for what a person is asked (`asks`),
and how precisely it `sees` fields of topics. With `at`, times, the conditions of rules count as they are
then, for a `message` if one is given. `assertion_check` evaluates.
"""

import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, TypeAlias

from grants.conditions import parse_timestamp
from grants.errors import ConditionRefused, MessageRefused
from grants.filters.layout import Array, Layout, Struct, Text, Type
from grants.model import Right
from grants.policy import source
from grants.policy.model import EVERYONE, Subject, SubjectPattern
from grants.policy.rules import RIGHTS
from grants.policy.source import Part, YamlMapping, YamlScalar, suggest

Value: TypeAlias = int | float | str
_NANO: Final = 10**9


_KEYS: Final = ("who", "may", "may_not", "asks", "sees", "at", "message")
EXACT: Final = "exact"
NOTHING: Final = "no"
# Seen no finer than this; or `no`, not at all; or `exact`, as it is; or a level of a word.
Limit: TypeAlias = float | str


def below(paths: Iterable[str], path: str) -> list[str]:
    plain = path.replace("[*]", "")
    return [leaf for leaf in paths if f"{leaf.replace('[*]', '')}.".startswith(f"{plain}.")]


# Messages for trying filters: a field that is not given is zero, an array has one element. Paths are those of
# filters; times are seconds.
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
    return {path: found.get(path) for path in layout.leaves()}


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
        value = values.get(path, 0)
        number = float(value) if kind.code in "fd" or len(kind.code) > 1 else int(value)
        # A time or a duration is two numbers.
        numbers = divmod(round(number * _NANO), _NANO) if len(kind.code) == 2 else (number,)
        yield struct.pack(f"<{kind.code}", *numbers)


def _count(data: bytes, at: int) -> int:
    return int(struct.unpack_from("<I", data, at)[0])


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


class Says(StrEnum):
    MAY = "may"
    MAY_NOT = "may_not"
    ASKS = "asks"


@dataclass(frozen=True)
class CheckedClaim:
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
class PolicyTest:
    subject: Subject  # the node; of an identity that is a pattern, one that it covers
    claims: tuple[CheckedClaim, ...] = ()
    seen: tuple[SeenField, ...] = ()
    at: tuple[int, ...] = ()  # seconds since the epoch; none: conditions are not evaluated
    message: Mapping[str, Value] = field(default_factory=dict)  # by path, for conditions on messages
    line: int = 0
    pattern: str = ""  # the nodes it is about, if it is about an identity that is a pattern


def read_tests(
    part: Part | None,
    identities: Mapping[str, SubjectPattern],
    groups: Mapping[str, tuple[SubjectPattern, ...]],
) -> tuple[PolicyTest, ...]:
    named = {name: (who,) for name, who in identities.items()}
    reader = _Reader({**named, **groups})
    return tuple(each for item in source.items(part) for each in reader.read(item))


@dataclass
class _Reader:
    _named: Mapping[str, tuple[SubjectPattern, ...]]

    def read(self, part: Part) -> list[PolicyTest]:
        mapping = source.mapping(part, "a test")
        if mapping is None:
            return []
        source.check_keys(mapping, "a test", _KEYS, ("who",))
        subjects = self._subjects(mapping.get("who"))
        claims = [claim for says in Says for claim in self._claims(mapping.get(says.value), says)]
        seen = self._seen(mapping.get("sees"), claims)
        at = tuple(self._times(mapping.get("at")))
        message = mapping.get("message")
        if not claims and not seen:
            mapping.mistake("a test that tests nothing", "add may, may_not or sees")
        if message is not None and not at:
            message.mistake("message needs at: conditions may read the time", "add at")
        values = self._message(message)
        return [
            PolicyTest(subject, tuple(claims), tuple(seen), at, values, mapping.line, pattern)
            for subject, pattern in subjects
        ]

    def _subjects(self, part: Part | None) -> list[tuple[Subject, str]]:
        label = source.text(part, "who")
        if label is None or part is None:
            return []
        if label in self._named:
            found = self._named[label]
            return [(who.sample, who.node if who.node and "*" in who.node else "") for who in found]
        if not (label.startswith("/") or ":" in label) or "*" in label or label == EVERYONE:
            hint = suggest(label, self._named) if self._named else "for example /heating"
            part.mistake(f"not a node, identity or group: {label[:60]!r}", hint)
            return []
        name = source.subject(part, "who")
        return [] if name is None else [(Subject(name, bytes(32)), "")]

    def _claims(self, part: Part | None, says: Says) -> list[CheckedClaim]:
        rights = source.mapping(part, says.value)
        found: list[CheckedClaim] = []
        for label, (key, value) in rights.entries.items() if rights is not None else ():
            if label not in RIGHTS:
                key.mistake(f"unknown right {label[:60]!r} in {says.value}", suggest(label, RIGHTS))
                continue
            for item in source.items(value):
                name = source.own_pattern(item, label, RIGHTS[label])
                if name is not None:
                    found.append(CheckedClaim(says, RIGHTS[label], name, item.line))
        return found

    def _seen(self, part: Part | None, claims: list[CheckedClaim]) -> list[SeenField]:
        topics = source.mapping(part, "sees")
        found: list[SeenField] = []
        for key, value in topics.entries.values() if topics is not None else ():
            topic = source.own_pattern(key, "sees", Right.SUBSCRIBE)
            if topic is None:
                continue
            if isinstance(value, YamlScalar) and value.value == NOTHING:
                claims.append(CheckedClaim(Says.MAY_NOT, Right.SUBSCRIBE, topic, key.line))
                continue
            fields = source.mapping(value, f"sees {topic}")
            for path, (at, limit) in fields.entries.items() if fields is not None else ():
                said = limit.value if isinstance(limit, YamlScalar) else None
                if isinstance(said, str):
                    found.append(SeenField(topic, path, said, at.line))
                elif isinstance(said, int | float) and not isinstance(said, bool) and said > 0:
                    found.append(SeenField(topic, path, float(said), at.line))
                else:
                    hint = f"write a number (no finer than that), {NOTHING} or {EXACT}"
                    limit.mistake("how a field is seen is said otherwise", hint)
        return found

    def _times(self, part: Part | None) -> list[int]:
        found: list[int] = []
        for item in source.items(part):
            text = source.text(item, "at") or "?"
            try:
                found.append(parse_timestamp(text))
            except ConditionRefused as error:
                if text != "?":
                    item.mistake(str(error), error.hint)
        return found

    def _message(self, part: Part | None) -> dict[str, Value]:
        first: dict[str, YamlScalar] = {}
        for path, value in self._values(part, ""):
            if path in first:
                source.again(value, f"message: {path[:80]!r}", first[path])
            first.setdefault(path, value)
        return {path: value.value for path, value in first.items()}

    def _values(self, part: Part | None, path: str) -> list[tuple[str, YamlScalar]]:
        if isinstance(part, YamlScalar) and path:
            return [(path, part)]
        mapping = source.mapping(part, path or "message")
        entries = mapping.entries.items() if isinstance(mapping, YamlMapping) else ()
        return [
            value
            for name, (_, inner) in entries
            for value in self._values(inner, f"{path}.{name}" if path else name)
        ]
