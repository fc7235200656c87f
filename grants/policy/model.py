"""A policy as values: identities, rules, and the names and rights in each rule.

All values are made by `grants.policy.read`, which checked them; nothing refers to the file any
more, except the line number of a rule.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Final

from ca.domains.aliases import is_alias
from ca.patterns import covers
from grants.limits import rate_text
from grants.model import FilterRule, Restriction, Right
from grants.policy.own_names import any_node, is_own, resolve
from grants.policy.patterns import includes
from grants.policy.vocabulary import Vocabulary

if TYPE_CHECKING:
    from grants.policy.assertions import Assertion

EVERYONE: Final = "*"
MINUTE, HOUR, DAY = 60, 3600, 86400
LIFETIME: Final = 7 * DAY
PROMPT_TIMEOUT: Final = MINUTE


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
        """Whether `subject` matches for certain: by name, and by key if one is pinned."""
        return self._name_fits(subject) and self.key in (None, subject.key)

    def may_match(self, subject: Subject) -> bool:
        """Whether `subject` matches by name *or* by pinned key: enough for a denial."""
        by_key = self.key is not None and self.key == subject.key
        by_name = self.node is not None and covers(self.node, subject.name)
        return by_key or by_name

    def _name_fits(self, subject: Subject) -> bool:
        if is_alias(subject.name):
            return self.node is not None and is_alias(self.node) and covers(self.node, subject.name)
        return self.node is None or covers(self.node, subject.name)


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
        """It for `subject`: `{node}/pose` with its name; None if it is about nothing then."""
        if not is_own(self.pattern):
            return self
        pattern = resolve(self.pattern, subject.name, tail=subject.tail)
        return None if pattern is None else replace(self, pattern=pattern, written=self.pattern)

    @property
    def shown(self) -> str:
        """The pattern, for people."""
        return f"{self.written}, here {self.pattern}" if self.written else self.pattern

    def lines(self) -> list[str]:
        """The restrictions as text."""
        lines = self.restriction.lines() if self.restriction is not None else []
        return lines if self.rate is None else [*lines, rate_text(self.rate)]


@dataclass(frozen=True)
class PolicyRule:
    """One rule.

    Args:
        lifetime, renew_until: seconds; `renew_until` 0 is never. The policy's defaults if the
            rule has none; `has_lifetime` says whether it has.
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
        """The subjects, by their labels in the policy; of a group its name."""
        exceptions = _labels(self.exceptions)
        return _labels(self.who) + (f" except {exceptions}" if exceptions else "")

    @property
    def reason(self) -> str:
        """The id and the reason as text."""
        return f"rule {self.id}" + (f": {self.why}" if self.why else "")


def _labels(subjects: Iterable[SubjectPattern]) -> str:
    return ", ".join(dict.fromkeys(who.group or who.label for who in subjects))


@dataclass(frozen=True)
class Defaults:
    """Values for rules without their own; an unanswered prompt is a denial."""

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
        """The message type of the topic or pattern `name`, if the policy has one."""
        return type_of(self.types, name)


def type_of(types: Mapping[str, str], name: str) -> str | None:
    """As `Policy.type_of`: the entry itself, else the only type of the patterns that cover it."""
    if name in types:
        return types[name]
    if is_own(name):
        found = {kind for of, kind in types.items() if includes(any_node(of), any_node(name))}
    elif "*" in name:
        return None
    else:
        found = {kind for of, kind in types.items() if _is_of(of, name)}
    return found.pop() if len(found) == 1 else None


def _is_of(pattern: str, name: str) -> bool:
    """Whether a type given for `pattern` is that of `name`, which may be a tail pattern."""
    if "*" not in pattern and not is_own(pattern):
        return pattern == name  # most are names, and each is compared for each name without a type
    return includes(any_node(pattern), name)
