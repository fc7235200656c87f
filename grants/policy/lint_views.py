"""What each receiver of a policy sees: every topic, with all that holds for it together.

Lint judges what a node gets, not what a rule says: two rules that are wise alone may undo each
other. A receiver is one sample node for each subject of the policy, once for each key that is
pinned for such a node; what a person may still approve counts as seen.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Final

from ca.patterns import covers
from grants.filters.layout import Layout
from grants.model import FilterRule, Right
from grants.policy.decision import Decider, Verdict
from grants.policy.lint_facts import (
    AMBIENT,
    CLOUDS,
    DEPTH,
    EVERYWHERE,
    Aspect,
    aspects,
    conventional,
    is_known,
)
from grants.policy.model import Clause, Effect, Policy, PolicyRule, Subject, SubjectPattern
from grants.policy.own_names import is_own
from grants.policy.patterns import includes
from grants.policy.privacy import filters_of, leaf_paths
from grants.vocabulary.describe import Description

LayoutOf = Callable[[str], Layout]

_HIDES: Final = frozenset({"clear", "set", "redact", "drop", "zero"})
_DEGREES: Final = frozenset({"latitude", "longitude"})
SMALLEST_BLOCK: Final = 32
MOST_ACROSS: Final = 20
"""Squares by which attackers' programs recognise few faces: 96 pixels in squares of 32 are 53 %."""
_FLOORS: Final[dict[Aspect, float]] = {
    Aspect.POSITION: 0.1,  # metres; localisation indoors errs by half of it
    Aspect.SURROUNDINGS: 0.1,
    Aspect.MOVEMENT: 0.02,  # metres a second
    Aspect.HEADING: 0.02,
    Aspect.JOINT: 0.02,  # radians
    Aspect.JOINT_RATE: 0.02,
    Aspect.TIME: 0.1,  # seconds
}
_DEGREE_FLOOR: Final = 0.0001  # eleven metres, what a receiver in a street errs


class Precision(StrEnum):
    """What is left of a field."""

    EXACT = "exact"
    COARSE = "coarse"
    HIDDEN = "hidden"


@dataclass(frozen=True)
class Receiver:
    """A sample node, and the subject of the policy it stands for."""

    subject: Subject
    who: SubjectPattern

    @property
    def label(self) -> str:
        """The name of the subject in the policy; of a member of a group that of the group."""
        return self.who.group or self.who.label


@dataclass(frozen=True)
class View:
    """What a receiver sees of one topic, or of all topics of a pattern."""

    receiver: Receiver
    topic: str
    verdict: Verdict
    layout: Layout | None
    described: Description | None

    @cached_property
    def filters(self) -> tuple[FilterRule, ...]:
        """All filters together."""
        return tuple(rule for item in self.verdict.restrictions for rule in item.filters)

    @cached_property
    def aspects(self) -> dict[str, Aspect]:
        """What each leaf of the message shows."""
        return aspects(self.described, self.topic) if self.described is not None else {}

    @cached_property
    def is_known(self) -> bool:
        """Whether it is known what the topic shows: by its type, else by its name."""
        if self.described is not None:
            return is_known(self.described)
        return conventional(self.topic) is not None

    def of(self, *wanted: Aspect) -> list[str]:
        """The leaves that show one of these."""
        return [path for path, aspect in self.aspects.items() if aspect in wanted]

    def left(self, path: str) -> Precision:
        """What all filters together leave of the leaf at `path`."""
        aspect = self.aspects.get(path, Aspect.NOTHING)
        return max(
            (_left_by(rule, aspect, path) for rule in filters_of(self.filters, path)),
            key=list(Precision).index,
            default=Precision.EXACT,
        )

    def exact(self, *wanted: Aspect) -> list[str]:
        """The leaves that show one of these exactly."""
        return [path for path in self.of(*wanted) if self.left(path) is Precision.EXACT]

    def treated(self, *wanted: Aspect) -> list[str]:
        """The leaves that show one of these coarsely or not at all."""
        return [path for path in self.of(*wanted) if self.left(path) is not Precision.EXACT]

    def coarse(self, *wanted: Aspect) -> list[str]:
        """The leaves that show one of these coarsely."""
        return [path for path in self.of(*wanted) if self.left(path) is Precision.COARSE]

    def shows(self, first: Aspect, *others: Aspect) -> bool:
        """Whether one of these is seen exactly, and the first is not treated."""
        if self.layout is None:
            return conventional(self.topic) in (first, *others)
        return bool(self.exact(first, *others)) and not self.treated(first)

    @property
    def shows_climate(self) -> bool:
        """Whether it shows exactly what a sensor measures that may be carried about."""
        fields = self.described.fields if self.described is not None else ()
        ambient = {field.path for field in fields if field.content in AMBIENT}
        return any(self.left(path) is Precision.EXACT for path in ambient)

    @property
    def shows_depth(self) -> bool:
        """Whether it shows exactly what a camera of depth sees: points in space, not one plane."""
        if self.layout is None:
            return self.topic.rpartition("/")[2] in CLOUDS
        return self.layout.type_name in DEPTH and bool(self.exact(Aspect.SURROUNDINGS))

    @property
    def is_slow(self) -> bool:
        """Whether something limits how often messages come, or tells only in which slot."""
        return self.verdict.rate is not None or self.has_slot

    @property
    def has_slot(self) -> bool:
        """Whether only one message in each slot comes."""
        return any(item.slot is not None for item in self.verdict.restrictions)

    @property
    def hides_presence(self) -> bool:
        """Whether its slots are about when messages come, not what is left of their content."""
        return self.has_slot and (self.is_empty or not self.filters)

    @cached_property
    def is_empty(self) -> bool:
        """Whether filters leave nothing of the message but that it was sent."""
        if self.layout is None or not self.filters:
            return False
        return all(self.left(path) is Precision.HIDDEN for path in leaf_paths(self.layout))

    @property
    def rule(self) -> PolicyRule:
        """The deciding rule that filters the topic, else the first."""
        return self.place()[0]

    def place(self, of: FilterRule | None = None) -> tuple[PolicyRule, Clause]:
        """The rule and clause with the filter `of`; without: the first with any, else the first."""
        places = list(zip(self.verdict.rules, self.verdict.clauses, strict=True))
        for rule, clause in places:
            own = clause.restriction.filters if clause.restriction is not None else ()
            if of in own or (of is None and own):
                return rule, clause
        return places[0]

    @property
    def is_below_pattern(self) -> bool:
        """Whether no rule names the topic itself: a pattern covers it."""
        return all(clause.pattern != self.topic for clause in self.verdict.clauses)

    def filter_on(self, path: str) -> FilterRule:
        """The first filter that treats the leaf at `path`."""
        return filters_of(self.filters, path)[0]


def _left_by(rule: FilterRule, aspect: Aspect, path: str) -> Precision:
    parameters = dict(rule.parameters)
    if rule.operator in _HIDES or parameters.get("length") == 0:
        return Precision.HIDDEN
    match rule.operator:
        case "clamp" | "truncate" | "sort":  # what is left is as it was
            return Precision.EXACT
        case "pixelate":
            return Precision.EXACT if too_small(rule) else Precision.COARSE
        case "round":
            return Precision.EXACT if too_fine(rule, aspect, path) else Precision.COARSE
        case _:
            return Precision.COARSE


def too_small(rule: FilterRule) -> bool:
    """Whether squares of pixels hide nothing: they are small, and many fit across a picture."""
    given = dict(rule.parameters)
    block, across = given.get("block"), given.get("across")
    if isinstance(across, int) and across <= MOST_ACROSS:
        return False
    return not isinstance(block, int) or block < SMALLEST_BLOCK


def too_fine(rule: FilterRule, aspect: Aspect, path: str) -> bool:
    """Whether a step is smaller than what sensors of this kind err."""
    step = dict(rule.parameters).get("step")
    degrees = path.rpartition(".")[2] in _DEGREES
    floor = _DEGREE_FLOOR if degrees else _FLOORS.get(aspect, 0.0)
    return isinstance(step, int | float) and step < floor


@dataclass(frozen=True)
class Scene:
    """A policy, and everything that its receivers see."""

    policy: Policy
    layout_of: LayoutOf
    _layouts: dict[str, Layout] = field(default_factory=dict)
    _contents: dict[str, tuple[Layout, Description] | tuple[None, None]] = field(
        default_factory=dict
    )

    @cached_property
    def decider(self) -> Decider:
        """Decides by the policy."""
        return Decider(self.policy)

    @cached_property
    def views(self) -> dict[Receiver, list[View]]:
        """All views, by receiver."""
        return {receiver: list(self._views(receiver)) for receiver in receivers(self.policy)}

    def contents(self, topic: str) -> tuple[Layout, Description] | tuple[None, None]:
        """The messages of `topic`, and what they contain, if the policy says their type."""
        if topic not in self._contents:
            kind = self.policy.type_of(topic)
            self._contents[topic] = (None, None) if kind is None else self._read(kind, topic)
        return self._contents[topic]

    def _read(self, kind: str, topic: str) -> tuple[Layout, Description]:
        if kind not in self._layouts:
            self._layouts[kind] = self.layout_of(kind)
        layout = self._layouts[kind]
        return layout, self.policy.vocabulary.describe(layout, topic)

    def _views(self, receiver: Receiver) -> Iterator[View]:
        rules = self.decider.rules_of(receiver.subject)
        for topic in _topics(self.policy, rules, receiver.subject):
            verdict = self.decider.decide_by(rules, receiver.subject, Right.SUBSCRIBE, topic)
            if verdict.effect is not Effect.DENY and verdict.rules:
                yield View(receiver, topic, verdict, *self.contents(topic))


def _topics(policy: Policy, rules: Iterable[PolicyRule], subject: Subject) -> list[str]:
    """What the rules name, and what is known of the topics below their patterns."""
    named = {
        found.pattern
        for rule in rules
        if rule.effect is not Effect.DENY
        for clause in rule.clauses
        if clause.right is Right.SUBSCRIBE and (found := clause.of(subject)) is not None
    }
    wide = [pattern for pattern in named if "*" in pattern]
    known = [*policy.types, *EVERYWHERE] if wide else []
    below = {
        topic
        for topic in known
        if not is_own(topic) and any(includes(pattern, topic) for pattern in wide)
    }
    return sorted(named | below)


def receivers(policy: Policy) -> list[Receiver]:
    """The receivers of everything that rules allow or prompt for, each once."""
    found: dict[Subject, Receiver] = {}
    pinned = [who for who in _subjects(policy) if who.key is not None]
    for who in _subjects(policy):
        name = sample_subject(who).name
        keys = {who.key} if who.key is not None else {None, *_pinned_for(name, pinned)}
        for key in keys:
            subject = Subject(name, key or bytes(32))
            found.setdefault(subject, Receiver(subject, who))
    return list(found.values())


def _subjects(policy: Policy) -> list[SubjectPattern]:
    rules = (rule for rule in policy.rules if rule.effect is not Effect.DENY)
    return list(dict.fromkeys(who for rule in rules for who in rule.who))


def _pinned_for(name: str, pinned: Iterable[SubjectPattern]) -> set[bytes | None]:
    return {who.key for who in pinned if who.node is None or covers(who.node, name)}


def sample_subject(who: SubjectPattern) -> Subject:
    """A subject that matches `who`, for trial decisions."""
    node = (who.node or "/x").replace("**", "x").replace("*", "x")
    return Subject(node, who.key or bytes(32))
