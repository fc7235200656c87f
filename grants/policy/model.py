"""A policy as values: identities, rules, and the names and rights in each rule.

All values are made by `grants.policy.read`, which checked them; nothing refers to the file any
more, except the line number of a rule.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from ca.domains.aliases import is_alias
from ca.patterns import covers
from grants.model import FilterRule, Restriction, Right

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
    """The requester: the certified name of a node and the thumbprint (32 bytes) of its key."""

    name: str
    key: bytes


@dataclass(frozen=True)
class SubjectPattern:
    """The nodes a rule is for: a name or name pattern, and optionally one pinned key.

    Nodes of foreign domains match only what names their domain (`hospital:/rounds/*`, an alias
    here), whatever else would cover the alias; a denial needs no more than to cover it.

    Args:
        label: its name in the policy.
        node: a name or pattern; None for any node with the key.
        key: a thumbprint of 32 bytes, or None for any key.
    """

    label: str
    node: str | None = None
    key: bytes | None = None

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
    """One right on one pattern, with the restriction of its rule; `rate` in messages per second."""

    right: Right
    pattern: str
    restriction: Restriction | None = None
    rate: float | None = None
    type: str | None = None

    def lines(self) -> list[str]:
        """The restrictions as text."""
        lines = self.restriction.lines() if self.restriction is not None else []
        return lines if self.rate is None else [*lines, f"at most {self.rate:g} messages a second"]


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
        """The subjects, by their labels in the policy."""
        exceptions = ", ".join(who.label for who in self.exceptions)
        return ", ".join(who.label for who in self.who) + (
            f" except {exceptions}" if exceptions else ""
        )

    @property
    def reason(self) -> str:
        """The id and the reason as text."""
        return f"rule {self.id}" + (f": {self.why}" if self.why else "")


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
    """A whole policy. `types` are message types by topic or pattern."""

    robot: str
    defaults: Defaults
    identities: Mapping[str, SubjectPattern]
    types: Mapping[str, str]
    rules: tuple[PolicyRule, ...]
    file: str = "policy.yaml"
    filters: Mapping[str, tuple[FilterRule, ...]] = field(default_factory=dict)

    def type_of(self, name: str) -> str | None:
        """The message type of the topic or pattern `name`, if the policy has one."""
        return type_of(self.types, name)


def type_of(types: Mapping[str, str], name: str) -> str | None:
    """As `Policy.type_of`: the entry itself, else the only type of the patterns that cover it."""
    if name in types:
        return types[name]
    if "*" in name:
        return None
    found = {kind for pattern, kind in types.items() if covers(pattern, name)}
    return found.pop() if len(found) == 1 else None
