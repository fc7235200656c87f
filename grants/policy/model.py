"""A policy as values: identities, rules, and what each rule says about which names.

Everything here is made by `grants.policy.read`, which checked it; nothing refers to the file any
more, except the line that a rule can be found at.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from grants.model import FilterRule, Restriction, Right
from grants.names import covers

EVERYONE: Final = "*"
MINUTE, HOUR, DAY = 60, 3600, 86400
LIFETIME: Final = 7 * DAY
PROMPT_TIMEOUT: Final = MINUTE


class Effect(StrEnum):
    """What a rule or a decision says; the strongest first."""

    DENY = "deny"
    ALLOW = "allow"
    PROMPT = "prompt"


@dataclass(frozen=True)
class Subject:
    """Who asks: the certified name of a node and the thumbprint (32 bytes) of its key."""

    name: str
    key: bytes


@dataclass(frozen=True)
class SubjectPattern:
    """Whom a rule is for: a name or name pattern, and perhaps one pinned key.

    Args:
        label: as the policy calls it.
        node: a name or pattern; None for whoever has the key.
        key: a thumbprint of 32 bytes, or None for any key.
    """

    label: str
    node: str | None = None
    key: bytes | None = None

    def admits(self, subject: Subject) -> bool:
        """Whether `subject` is surely meant: the name fits, and the key if one is pinned."""
        return self._name_fits(subject) and self.key in (None, subject.key)

    def suspects(self, subject: Subject) -> bool:
        """Whether `subject` has the name *or* the pinned key: enough to be denied."""
        by_key = self.key is not None and self.key == subject.key
        by_name = self.node is not None and covers(self.node, subject.name)
        return by_key or by_name

    def _name_fits(self, subject: Subject) -> bool:
        return self.node is None or covers(self.node, subject.name)


@dataclass(frozen=True)
class Clause:
    """One right on one pattern, as a rule restricts it; `rate` is in messages per second."""

    right: Right
    pattern: str
    restriction: Restriction | None = None
    rate: float | None = None
    type: str | None = None

    def lines(self) -> list[str]:
        """The restrictions for people."""
        lines = self.restriction.lines() if self.restriction is not None else []
        return lines if self.rate is None else [*lines, f"at most {self.rate:g} messages a second"]


@dataclass(frozen=True)
class PolicyRule:
    """One rule.

    Args:
        lifetime, renew_until: seconds; `renew_until` 0 is never. Already the policy's defaults
            where the rule names none; `own_lifetime` says whether it did.
        keep_when_stale: its connections outlive missing news of revocations (`on_stale: keep`).
    """

    id: str
    effect: Effect
    who: tuple[SubjectPattern, ...]
    clauses: tuple[Clause, ...]
    why: str = ""
    exceptions: tuple[SubjectPattern, ...] = ()
    lifetime: int = LIFETIME
    renew_until: int = 0
    own_lifetime: bool = False
    keep_when_stale: bool = False
    line: int = 0

    def is_for(self, subject: Subject) -> bool:
        """Whether the rule speaks about `subject`; a denial does so on the weaker evidence."""
        if any(who.admits(subject) for who in self.exceptions):
            return False
        if self.effect is Effect.DENY:
            return any(who.suspects(subject) for who in self.who)
        return any(who.admits(subject) for who in self.who)

    @property
    def people(self) -> str:
        """Whom it is for, in the policy's words."""
        exceptions = ", ".join(who.label for who in self.exceptions)
        return ", ".join(who.label for who in self.who) + (
            f" except {exceptions}" if exceptions else ""
        )

    @property
    def reason(self) -> str:
        """The id and the reason, for people."""
        return f"rule {self.id}" + (f": {self.why}" if self.why else "")


@dataclass(frozen=True)
class Defaults:
    """What holds where no rule says otherwise; an unanswered prompt is a denial."""

    decision: Effect = Effect.DENY
    lifetime: int = LIFETIME
    renew_until: int = 0
    prompt_timeout: int = PROMPT_TIMEOUT
    own_lifetime: bool = False


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
        """The message type of the topic or pattern `name`, if the policy says one."""
        return type_of(self.types, name)


def type_of(types: Mapping[str, str], name: str) -> str | None:
    """As `Policy.type_of`: the entry itself, else the only type of the patterns that cover it."""
    if name in types:
        return types[name]
    if "*" in name:
        return None
    found = {kind for pattern, kind in types.items() if covers(pattern, name)}
    return found.pop() if len(found) == 1 else None
