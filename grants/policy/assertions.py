"""`tests` of a policy: what must stay true of it, read from the file. Values and their reader.

Each assertion is about one node: what it `may` use, what it `may_not`, for what a person is asked
(`asks`), and how precisely it `sees` fields of topics. With `at`, times, the conditions of rules
count as they are then, for a `message` if one is given. `assertion_check` evaluates.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, TypeAlias

from grants.conditions.calendar import parse_timestamp
from grants.errors import ConditionRefused
from grants.model import Right
from grants.policy import readers
from grants.policy.mistakes import Mistakes, suggest
from grants.policy.model import EVERYONE, Subject, SubjectPattern
from grants.policy.rules import RIGHTS
from grants.policy.sample_messages import Value
from grants.policy.source import Part, YamlMapping, YamlScalar

_KEYS: Final = ("who", "may", "may_not", "asks", "sees", "at", "message")
EXACT: Final = "exact"
NOTHING: Final = "no"
_LIMITS: Final = f"a number (no finer than that), {NOTHING} or {EXACT}"

Limit: TypeAlias = float | str
"""Seen no finer than this; or `no`, not at all; or `exact`, as it is; or a level of a word."""


class Says(StrEnum):
    """What an assertion says of a right."""

    MAY = "may"
    MAY_NOT = "may_not"
    ASKS = "asks"


@dataclass(frozen=True)
class Claim:
    """Of one right on one name or pattern."""

    says: Says
    right: Right
    name: str
    line: int


@dataclass(frozen=True)
class SeenField:
    """Of one field of a topic, or of one word of the vocabulary, such as `position`."""

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
    """Read `tests`; one about a group is one about each of its members."""
    named = {name: (who,) for name, who in identities.items()}
    reader = _Reader({**named, **groups}, mistakes)
    return tuple(each for item in readers.items(part) for each in reader.read(item))


class _Reader:
    def __init__(self, named: Mapping[str, tuple[SubjectPattern, ...]], mistakes: Mistakes) -> None:
        self._named = named
        self._mistakes = mistakes

    def read(self, part: Part) -> list[Assertion]:
        mapping = readers.mapping(part, "a test", self._mistakes)
        if mapping is None:
            return []
        readers.check_keys(mapping, "a test", _KEYS, ("who",), self._mistakes)
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
        """The nodes, each with the pattern it stands for, if any."""
        label = readers.text(part, "who", self._mistakes)
        if label is None or part is None:
            return []
        if label in self._named:
            return [_sample(who) for who in self._named[label]]
        if not (label.startswith("/") or ":" in label) or "*" in label or label == EVERYONE:
            hint = suggest(label, self._named) if self._named else "for example /heating"
            self._mistakes.add(part, f"not a node, identity or group: {label[:60]!r}", hint)
            return []
        name = readers.subject(part, "who", self._mistakes)
        return [] if name is None else [(Subject(name, bytes(32)), "")]

    def _claims(self, part: Part | None, says: Says) -> list[Claim]:
        rights = readers.mapping(part, says.value, self._mistakes)
        found: list[Claim] = []
        for label, (key, value) in rights.entries.items() if rights is not None else ():
            if label not in RIGHTS:
                message = f"unknown right {label[:60]!r} in {says.value}"
                self._mistakes.add(key, message, suggest(label, RIGHTS))
                continue
            for item in readers.items(value):
                name = readers.own_pattern(item, label, RIGHTS[label], self._mistakes)
                if name is not None:
                    found.append(Claim(says, RIGHTS[label], name, item.line))
        return found

    def _seen(self, part: Part | None, claims: list[Claim]) -> list[SeenField]:
        """The fields; a topic of which nothing is seen is a claim."""
        topics = readers.mapping(part, "sees", self._mistakes)
        found: list[SeenField] = []
        for key, value in topics.entries.values() if topics is not None else ():
            topic = readers.own_pattern(key, "sees", Right.SUBSCRIBE, self._mistakes)
            if topic is None:
                continue
            if isinstance(value, YamlScalar) and value.value == NOTHING:
                claims.append(Claim(Says.MAY_NOT, Right.SUBSCRIBE, topic, key.line))
                continue
            fields = readers.mapping(value, f"sees {topic}", self._mistakes)
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
        for item in readers.items(part):
            text = readers.text(item, "at", self._mistakes) or "?"
            try:
                found.append(parse_timestamp(text))
            except ConditionRefused as error:
                if text != "?":
                    self._mistakes.add(item, str(error), error.hint)
        return found

    def _message(self, part: Part | None) -> dict[str, Value]:
        """The values of a message, by path: `{pose: {x: 1}}` and `{pose.x: 1}` are the same one."""
        first: dict[str, YamlScalar] = {}
        for path, value in self._values(part, ""):
            if path in first:
                readers.again(value, f"message: {path[:80]!r}", first[path], self._mistakes)
            first.setdefault(path, value)
        return {path: value.value for path, value in first.items()}

    def _values(self, part: Part | None, path: str) -> list[tuple[str, YamlScalar]]:
        """The values in a message, by path."""
        if isinstance(part, YamlScalar) and path:
            return [(path, part)]
        mapping = readers.mapping(part, path or "message", self._mistakes)
        entries = mapping.entries.items() if isinstance(mapping, YamlMapping) else ()
        return [
            value
            for name, (_, inner) in entries
            for value in self._values(inner, f"{path}.{name}" if path else name)
        ]


def _sample(who: SubjectPattern) -> tuple[Subject, str]:
    """A node that `who` is for, and the pattern it stands for, if any."""
    written = who.node or "/x"
    node = written.replace("**", "x").replace("*", "x")
    return Subject(node, who.key or bytes(32)), "" if node == written else written
