"""A policy as values: identities, rules, and the names and rights in each rule.

All values are made by `grants.policy.read`, which checked them; nothing refers to the file any more, except
the line number of a rule. The vocabulary of a policy names types (`acme_msgs/Bed`) and topics (`/door/open`,
for a value whose meaning only the topic knows). A field tells a word, and is then hidden at every level but
`exact`, or has a content of `grants.vocabulary.contents`, and is then treated as these are.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Final

from ca.names import is_alias, pattern_covers
from grants.errors import FilterRefused
from grants.filters.layout import TYPE_NAME, Layout
from grants.limits import rate_text
from grants.model import FilterRule, Restriction, Right
from grants.policy import source
from grants.policy.names import BEGINS_TOPIC, any_node, includes, intersects, is_own, resolve
from grants.policy.source import Part, YamlMapping, YamlScalar, suggest
from grants.vocabulary.contents import NOT_KNOWN, Content, DataWord, Description, Fields, describe
from grants.vocabulary.levels import Treatment, plan_treatment

if TYPE_CHECKING:
    from grants.policy.assertions import PolicyTest as Assertion

EVERYONE: Final = "*"
MINUTE, HOUR, DAY = 60, 3600, 86400
LIFETIME: Final = 7 * DAY
PROMPT_TIMEOUT: Final = MINUTE

# A word alone: a content of that word that no level shows in part.
_HIDDEN: Final[dict[str, Content]] = {
    DataWord.POSITION: Content.UNCERTAINTY,
    DataWord.MOVEMENT: Content.JOINT,
    DataWord.IMAGE: Content.COMPRESSED_PICTURE,
    DataWord.SOUND: Content.SAMPLES,
    DataWord.PRESENCE: Content.TIME,
    DataWord.IDENTITY: Content.MARK,
    DataWord.HOME: Content.READING,
}
# Pixels can only be treated where their size is said, in a sensor_msgs/Image.
_UNSAID: Final = NOT_KNOWN | {Content.PICTURE}
# What a policy can say of a field.
SAYABLE: Final[Mapping[str, Content]] = {
    **{one.value: one for one in Content if one not in _UNSAID},
    **_HIDDEN,
}


@dataclass(frozen=True)
class Vocabulary:
    """Contents by field, by type and by topic or pattern of topics; and the rooms there are."""

    types: Mapping[str, Fields] = field(default_factory=dict)
    topics: Mapping[str, Fields] = field(default_factory=dict)
    rooms: Treatment | None = None

    def describe(self, layout: Layout, topic: str = "") -> Description:
        """The contents of messages of `layout` on `topic`."""
        here = self._said(topic)
        doubtful = dict.fromkeys(self.contradictions(layout, topic), Content.UNKNOWN)
        return describe(layout, self.types, {**here, **doubtful})

    def contradictions(self, layout: Layout, topic: str) -> dict[str, str]:
        """Fields of which the vocabulary says one thing here and another elsewhere in `topic`.

        Each with the topic or pattern that says so: a narrower one than the pattern `topic`, or one
        that overlaps with another. None can be held for all, so they are unknown.
        """
        here = self._said(topic)
        known = describe(layout, self.types, here)
        found: dict[str, str] = {}
        for pattern, fields in self.topics.items() if topic else ():
            if self._decides(pattern, topic) or not intersects(any_node(pattern), any_node(topic)):
                continue
            for path, content in fields.items():
                below = {one.content for one in known.fields if _is_below(one.path, path)}
                if below - {content}:
                    found[path] = pattern
        return found

    def _said(self, topic: str) -> dict[str, Content]:
        covering = [pattern for pattern in self.topics if topic and self._covers(pattern, topic)]
        here: dict[str, Content] = {}
        # The narrower, the later, so that it decides.
        wider = {one: sum(self._covers(one, other) for other in covering) for one in covering}
        for pattern in sorted(covering, key=wider.__getitem__, reverse=True):
            here.update(self.topics[pattern])
        return here

    def _covers(self, pattern: str, topic: str) -> bool:
        return includes(any_node(pattern), any_node(topic))

    def _decides(self, pattern: str, topic: str) -> bool:
        # Whether `pattern` covers `topic`, and what it says is said again or not contradicted.
        # So it is if `topic` itself is in the vocabulary, or all that cover it are nested.
        covering = [each for each in self.topics if self._covers(each, topic)]
        return pattern in covering and (
            topic in covering
            or all(self._covers(pattern, one) or self._covers(one, pattern) for one in covering)
        )


# The layout of a type; None if it is unknown, which is then recorded as a mistake.
LayoutOfType = Callable[[str, YamlScalar], Layout | None]


def read_rooms(part: Part | None) -> Treatment | None:
    mapping = source.mapping(part, "rooms")
    if mapping is None:
        return None
    plan = {name: source.text(value, name) for name, (_, value) in mapping.entries.items()}
    if None in plan.values():
        return None
    try:
        return plan_treatment({name: text for name, text in plan.items() if text is not None})
    except FilterRefused as error:
        mapping.mistake(str(error).removeprefix("position: "), error.hint)
        return None


def read_vocabulary(
    part: Part | None, rooms: Part | None, types: Mapping[str, str], layout_of: LayoutOfType
) -> Vocabulary:
    found: dict[bool, dict[str, Fields]] = {True: {}, False: {}}

    def read_key(key: YamlScalar) -> str | None:
        is_topic = str(key.value).startswith(BEGINS_TOPIC)
        return source.pattern(key, "topic") if is_topic else str(key.value)

    for name, key, value in source.by_name(part, "vocabulary", read_key):
        is_topic = name.startswith(BEGINS_TOPIC)
        type_name = types.get(name) if is_topic else name
        fields = source.mapping(value, f"vocabulary of {name}")
        if type_name is None:
            hint = suggest(name, types) or f"add it to types: {{{name}: package/Type}}"
            key.mistake(f"the message type of {name[:80]} is unknown", hint)
        elif fields is not None and TYPE_NAME.fullmatch(type_name) is None:
            key.mistake(f"not a type or a topic: {type_name[:80]!r}", "package/Type, or /topic")
        elif fields is not None and (layout := layout_of(type_name, key)) is not None:
            found[is_topic][name] = _fields(layout, fields)
    return Vocabulary(found[False], found[True], read_rooms(rooms))


def _is_below(leaf: str, path: str) -> bool:
    return f"{leaf}.".replace("[*]", "").startswith(f"{path}.")


def _fields(layout: Layout, mapping: YamlMapping) -> Fields:
    known = describe(layout)
    fields: dict[str, Content] = {}
    for path, key, value in source.by_name(
        mapping, known.type_name, lambda key: str(key.value).replace("[*]", "")
    ):
        said = source.choice(value, "word or content", SAYABLE)
        if said is None:
            continue
        below = [one for one in known.fields if _is_below(one.path, path)]
        if not below:
            hint = suggest(path, [one.path for one in known.fields])
            key.mistake(f"no field {path[:80]!r} in {known.type_name}", hint)
        # What the standard table knows cannot be said otherwise.
        elif any(one.content not in NOT_KNOWN for one in below):
            message = f"{path} of {known.type_name} is in the standard vocabulary"
            key.mistake(message, f"it is: {below[0].content}; remove this line")
        else:
            fields[path] = SAYABLE[said]
    return fields


class Effect(StrEnum):
    """The effect of a rule or a decision; the strongest first."""

    DENY = "deny"
    ALLOW = "allow"
    PROMPT = "prompt"


@dataclass(frozen=True)
class Subject:
    """The requester: the certified name of a node and the thumbprint (32 bytes) of its key.

    `tail`: its identity has a wildcard tail, so it is all anonymous nodes of its name.
    """

    name: str
    key: bytes
    tail: bool = False


@dataclass(frozen=True)
class SubjectPattern:
    """The nodes a rule is for: a name or name pattern, and optionally one pinned key.

    Nodes of foreign domains match only what names their domain (`hospital:/rounds/*`, an alias
    here), whatever else would cover the alias; a denial needs no more than to cover it.

    Args:
        label: its name in the policy.
        node: a name or pattern; None for any node with the key.
        key: a thumbprint of 32 bytes, or None for any key.
        group: the group by which a rule names it, or empty.
    """

    label: str
    node: str | None = None
    key: bytes | None = None
    group: str = ""

    def matches(self, subject: Subject) -> bool:
        named = self.node is not None and pattern_covers(self.node, subject.name)
        if is_alias(subject.name):
            named = named and is_alias(self.node or "")
        elif self.node is None:
            named = True
        return named and self.key in (None, subject.key)

    def may_match(self, subject: Subject) -> bool:
        by_key = self.key is not None and self.key == subject.key
        by_name = self.node is not None and pattern_covers(self.node, subject.name)
        return by_key or by_name

    @property
    def sample(self) -> Subject:
        """A subject that it matches, for trial decisions."""
        node = (self.node or "/x").replace("**", "x").replace("*", "x")
        return Subject(node, self.key or bytes(32))


@dataclass(frozen=True)
class Clause:
    """One right on one pattern, with the restriction of its rule; `rate` in messages per second.

    `written`: the pattern in the rule, where `pattern` is what it is for one node.
    """

    right: Right
    pattern: str
    restriction: Restriction | None = None
    rate: float | None = None
    type: str | None = None
    written: str = ""

    def of(self, subject: Subject) -> "Clause | None":
        if not is_own(self.pattern):
            return self
        pattern = resolve(self.pattern, subject.name, tail=subject.tail)
        return None if pattern is None else replace(self, pattern=pattern, written=self.pattern)

    @property
    def shown(self) -> str:
        return f"{self.written}, here {self.pattern}" if self.written else self.pattern

    def lines(self) -> list[str]:
        lines = self.restriction.lines() if self.restriction is not None else []
        return lines if self.rate is None else [*lines, rate_text(self.rate)]


@dataclass(frozen=True)
class PolicyRule:
    """One rule.

    Args:
        lifetime, renew_until: seconds, 0 is never renewed; the policy's defaults if not `has_lifetime`.
        keep_when_stale: connections stay open on stale revocation data (`on_stale: keep`).
    """

    id: str
    effect: Effect
    who: tuple[SubjectPattern, ...]
    clauses: tuple[Clause, ...]
    why: str = ""
    exceptions: tuple[SubjectPattern, ...] = ()
    lifetime: int = LIFETIME
    renew_until: int = 0
    has_lifetime: bool = False
    keep_when_stale: bool = False
    line: int = 0

    def applies_to(self, subject: Subject) -> bool:
        """Whether the rule is for `subject`; a denial needs a weaker match."""
        if any(who.matches(subject) for who in self.exceptions):
            return False
        if self.effect is Effect.DENY:
            return any(who.may_match(subject) for who in self.who)
        return any(who.matches(subject) for who in self.who)

    @property
    def subjects_text(self) -> str:
        exceptions = _labels(self.exceptions)
        return _labels(self.who) + (f" except {exceptions}" if exceptions else "")

    @property
    def cited(self) -> str:
        return f"rule {self.id}, line {self.line}"

    @property
    def reason(self) -> str:
        return f"rule {self.id}" + (f": {self.why}" if self.why else "")


def _labels(subjects: Iterable[SubjectPattern]) -> str:
    return ", ".join(dict.fromkeys(who.group or who.label for who in subjects))


@dataclass(frozen=True)
class Defaults:
    decision: Effect = Effect.DENY
    lifetime: int = LIFETIME
    renew_until: int = 0
    prompt_timeout: int = PROMPT_TIMEOUT
    has_lifetime: bool = False


@dataclass(frozen=True)
class Policy:
    """A whole policy. `types` are message types by topic or pattern.

    `groups` are their members by name; `unused_groups` are those that no rule is for. `titles` are
    names for people, by the name of a node, a topic or a pattern; they decide nothing.
    """

    robot: str
    defaults: Defaults
    identities: Mapping[str, SubjectPattern]
    types: Mapping[str, str]
    rules: tuple[PolicyRule, ...]
    file: str = "policy.yaml"
    filters: Mapping[str, tuple[FilterRule, ...]] = field(default_factory=dict)
    groups: Mapping[str, tuple[SubjectPattern, ...]] = field(default_factory=dict)
    unused_groups: tuple[str, ...] = ()
    vocabulary: Vocabulary = field(default_factory=Vocabulary)
    tests: "tuple[Assertion, ...]" = ()
    titles: Mapping[str, str] = field(default_factory=dict)

    def type_of(self, name: str) -> str | None:
        return type_of(self.types, name)


def type_of(types: Mapping[str, str], name: str) -> str | None:
    """As `Policy.type_of`: the entry itself, else the only type of the patterns that cover it."""
    if name in types:
        return types[name]
    if is_own(name):
        found = {kind for of, kind in types.items() if includes(any_node(of), any_node(name))}
    elif "*" in name:
        return None
    else:  # most are names, which cover no other one
        patterns = ((of, kind) for of, kind in types.items() if "*" in of or is_own(of))
        found = {kind for of, kind in patterns if includes(any_node(of), name)}
    return found.pop() if len(found) == 1 else None
