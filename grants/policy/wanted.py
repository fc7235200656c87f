"""What a policy gives a node outright: the wanted state, which `rossec policy apply` makes true.

Each clause of an allowing rule is decided whole, as a request for its pattern would be. Only what
is allowed is wanted: what a person decides is left to a person, and a pattern of which one name is
denied is withheld whole: a grant cannot say "except". Both are reported with their rules.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

from ca.domains.aliases import is_alias
from grants.model import Permission, Right
from grants.policy.decision import Decider, Verdict
from grants.policy.drafts import permissions
from grants.policy.model import Effect, PolicyRule, Subject
from grants.policy.own_names import is_own

Atom = tuple[Right, str]
"""One right on one name or pattern."""

_Key = tuple[bool | str | int, ...]


@dataclass(frozen=True)
class WantedRight:
    """One right on one pattern, as the policy gives it.

    Args:
        permissions: the entries of a grant that say so; all of them hold together.
        rules: the deciding rules.
        lifetime, renew_until: seconds; `renew_until` 0 is never.
    """

    right: Right
    pattern: str
    permissions: tuple[Permission, ...]
    rules: tuple[PolicyRule, ...]
    lifetime: int
    renew_until: int

    @classmethod
    def of(cls, verdict: Verdict) -> "WantedRight":
        """What a verdict of ALLOW gives."""
        return cls(
            verdict.right, verdict.name, tuple(permissions(verdict)),
            tuple(dict.fromkeys(verdict.rules)), verdict.lifetime,
            0 if is_alias(verdict.subject.name) else verdict.renew_until,
        )  # fmt: skip

    @property
    def atom(self) -> Atom:
        """What it is about."""
        return self.right, self.pattern

    @property
    def rule_ids(self) -> str:
        """The deciding rules by id, as the record has them."""
        return rule_ids(self.rules)


class Withheld(NamedTuple):
    """A right that `rule` has, and that `by` keeps from being granted outright.

    `effect` is DENY if `by` denies a name of the pattern, and PROMPT if a person decides.
    """

    right: Right
    pattern: str
    effect: Effect
    rule: PolicyRule
    by: PolicyRule


class Wanted(NamedTuple):
    """What one node gets outright, each right once, and what it does not get."""

    rights: tuple[WantedRight, ...] = ()
    withheld: tuple[Withheld, ...] = ()


class WantedState:
    """The wanted state of one policy.

    Nodes to which the same rules apply share the work, unless one is about the node's own names.
    """

    def __init__(self, decider: Decider) -> None:
        self._decider = decider
        self._wanted: dict[_Key, Wanted] = {}
        self._verdicts: dict[tuple[_Key, Atom], Verdict] = {}
        self._last: tuple[Subject | None, list[PolicyRule], _Key] = (None, [], ())

    def of(self, subject: Subject) -> Wanted:
        """What the policy gives `subject` outright.

        Raises:
            NameRefused: `subject.name` is not an absolute name.
        """
        rules, key = self._rules_of(subject)
        if key not in self._wanted:
            self._wanted[key] = self._decide_all(rules, subject)
        return self._wanted[key]

    def decide(self, subject: Subject, atom: Atom) -> Verdict:
        """As `Decider.decide`, of a right and a pattern that were checked before."""
        rules, key = self._rules_of(subject)
        verdict = self._verdicts.get((key, atom))
        if verdict is None:
            verdict = self._decider.decide_by(rules, subject, *atom)
            self._verdicts[key, atom] = verdict
        return replace(verdict, subject=subject)

    def _rules_of(self, subject: Subject) -> tuple[list[PolicyRule], _Key]:
        """The rules for `subject`, and what names them: the policy keeps them alive."""
        if self._last[0] != subject:
            rules = self._decider.rules_of(subject)
            # No master renews grants of foreigners, so they share nothing with own nodes.
            own = (subject.name,) if subject.tail or any(map(_has_own_names, rules)) else ()
            key = (is_alias(subject.name), subject.tail, *own, *map(id, rules))
            self._last = (subject, rules, key)
        return self._last[1:]

    def _decide_all(self, rules: list[PolicyRule], subject: Subject) -> Wanted:
        rights: dict[Atom, WantedRight] = {}
        withheld: dict[tuple[Atom, str], Withheld] = {}
        for rule, atom in _clauses(rules, subject):
            verdict = self._decider.decide_by(rules, subject, *atom)
            if verdict.effect is Effect.ALLOW:
                rights.setdefault(atom, WantedRight.of(verdict))
            else:
                found = Withheld(*atom, verdict.effect, rule, verdict.rules[0])
                withheld.setdefault((atom, rule.id), found)
        return Wanted(tuple(rights.values()), tuple(withheld.values()))


def rule_ids(rules: Iterable[PolicyRule]) -> str:
    """The ids of `rules`, as text."""
    return " ".join(sorted({rule.id for rule in rules}))


def _has_own_names(rule: PolicyRule) -> bool:
    return any(is_own(clause.pattern) for clause in rule.clauses)


def _clauses(rules: list[PolicyRule], subject: Subject) -> Iterator[tuple[PolicyRule, Atom]]:
    """The rights that the rules have for `subject`, of allowing and of prompting rules."""
    for rule in rules:
        if rule.effect is not Effect.DENY:
            for clause in rule.clauses:
                if (found := clause.of(subject)) is not None:
                    yield rule, (found.right, found.pattern)
