"""What a policy would grant to a name: shown before the name is certified for a key."""

from collections.abc import Iterable, Iterator
from typing import Final

from grants.policy.basics import is_basics
from grants.policy.model import Clause, Policy, PolicyRule, Subject
from grants.policy.patterns import intersects

_BASICS: Final = "allow what every ROS program needs: its log, its loggers, the clock (rule basics)"


def projected_grants(policy: Policy, subject: Subject) -> list[str]:
    """What is allowed, prompted or denied for `subject`, a line each, in the order of the rules."""
    return [
        line
        for rule in policy.rules
        if rule.applies_to(subject)
        for line in [_BASICS] * is_basics(rule)
        or _lines(rule, filter(None, (each.of(subject) for each in rule.clauses)))
    ]


def projected_for_names(policy: Policy, pattern: str) -> list[str]:
    """As `projected_grants`, for every name that `pattern` covers: with whom each rule is for."""
    return [
        f"{rule.subjects_text}: {line}"
        for rule in policy.rules
        if any(who.node is not None and intersects(who.node, pattern) for who in rule.who)
        for line in [_BASICS] * is_basics(rule) or _lines(rule, rule.clauses)
    ]


def _lines(rule: PolicyRule, clauses: Iterable[Clause]) -> Iterator[str]:
    for clause in clauses:
        yield f"{rule.effect} {clause.right.label} {clause.shown} ({rule.reason})"
        yield from (f"  {line}" for line in clause.lines())
