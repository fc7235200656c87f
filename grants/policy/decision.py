"""The decision of a policy: deny > allow > prompt > default, and its explanation.

All rules that match are evaluated, whatever their order: one denial overrides everything, and of
the allowing rules *all* restrictions apply together, so adding a rule never silently widens what
another narrowed. An unknown right, an invalid name or no matching rule is never allowed.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from typing import Final

from ca.names import check_name
from ca.patterns import check_tail_pattern, tail_base
from grants.errors import PolicyRefused
from grants.limits import rate_text
from grants.model import KEEP_WHEN_STALE, TREE_RIGHTS, Restriction, Right, merge
from grants.policy.index import Hit, Index, applied, hits, is_pattern
from grants.policy.model import DAY, HOUR, MINUTE, Clause, Effect, Policy, PolicyRule, Subject
from grants.policy.own_names import check_rule_pattern, is_own, resolve
from grants.policy.patterns import gives, overlaps

MAX_NEAR_MISSES: Final = 5
_STRENGTH: Final = (Effect.DENY, Effect.ALLOW, Effect.PROMPT)


@dataclass(frozen=True)
class Verdict:
    """The decision, and everything needed to explain it. True only for ALLOW.

    Args:
        rules: the deciding rules, by id; none if the default decided.
        restrictions, rate: all that must be applied together, for ALLOW and PROMPT.
        lifetime, renew_until: seconds; the shortest of the deciding rules.
    """

    effect: Effect
    subject: Subject
    right: Right
    name: str
    rules: tuple[PolicyRule, ...] = ()
    clauses: tuple[Clause, ...] = ()
    lifetime: int = 0
    renew_until: int = 0

    def __bool__(self) -> bool:
        return self.effect is Effect.ALLOW

    @property
    def restrictions(self) -> tuple[Restriction, ...]:
        """The restrictions of the right; all of them apply together."""
        return merge(clause.restriction for clause in self.clauses)

    @property
    def rate(self) -> float | None:
        """The maximum of messages a second, or None."""
        return min((c.rate for c in self.clauses if c.rate is not None), default=None)

    @property
    def keep_when_stale(self) -> bool:
        """Whether every deciding rule says `on_stale: keep`."""
        return len(self.rules) > 0 and all(rule.keep_when_stale for rule in self.rules)

    @property
    def headline(self) -> str:
        """`ALLOW: /heating subscribe /robot/pose`."""
        return f"{self.effect.upper()}: {self.subject.name} {self.right.label} {self.name}"


class Decider:
    """Decides by one policy."""

    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self._index = Index(policy)

    def decide(self, subject: Subject, right: Right, name: str) -> Verdict:
        """Evaluate the policy for one right on one name (or a whole pattern).

        `name` may be an own name as a rule has it, `{node}/pose`. A tail pattern is denied to
        every node but that of the tail.

        Raises:
            PatternRefused: `name` is invalid.
            NameRefused: `subject.name` is not an absolute name.
            PolicyRefused: not exactly one right.
        """
        check_name(subject.name)
        if right.bit_count() != 1:
            raise PolicyRefused(f"{int(right)} is not one right")
        if is_own(name):
            own = resolve(check_rule_pattern(name), subject.name, tail=subject.tail)
            if own is None:
                return Verdict(Effect.DENY, subject, right, name)
            name = own
        check_tail_pattern(name)
        return self._evaluate(subject, right, name, self._index.find(subject, right, name))

    def rules_of(self, subject: Subject) -> list[PolicyRule]:
        """The rules that apply to `subject`."""
        return self._index.rules_of(subject)

    def decide_by(
        self, rules: Iterable[PolicyRule], subject: Subject, right: Right, name: str
    ) -> Verdict:
        """As `decide`, with all checked before; `rules` are those of the subject (`rules_of`)."""
        found = (
            list(applied(rules, subject, right, name))
            if is_pattern(name)
            else self._index.find(subject, right, name)
        )
        return self._evaluate(subject, right, name, found)

    def decide_without(self, verdict: Verdict) -> Verdict:
        """The verdict without the rules that decided it."""
        rules = [rule for rule in self.policy.rules if rule not in verdict.rules]
        found = hits(rules, verdict.subject, verdict.right, verdict.name)
        return self._evaluate(verdict.subject, verdict.right, verdict.name, list(found))

    def explain(self, verdict: Verdict) -> list[str]:
        """The verdict as text, line by line."""
        lines = [verdict.headline]
        for rule, clause in zip(verdict.rules, verdict.clauses, strict=False):
            lines.append(f"  {rule.reason} ({rule.effect} {clause.right.label} {clause.shown})")
        if verdict.effect is not Effect.DENY:
            lines += [f"    {line}" for line in restriction_lines(verdict)]
        if not verdict.rules:
            lines.append("  no rule matches, so the default decides")
        lines += [f"  near miss: {line}" for line in self.near_misses(verdict)]
        return lines + [f"  {line}" for line in self.changes(verdict)]

    def near_misses(self, verdict: Verdict) -> list[str]:
        """For a decision by default: the rules that nearly matched, and why they did not."""
        if verdict.rules:
            return []
        found = (_near_miss(rule, verdict) for rule in self.policy.rules)
        return [miss for miss in found if miss][:MAX_NEAR_MISSES]

    def changes(self, verdict: Verdict) -> list[str]:
        """The change of the policy that would change the decision."""
        subject, right, name = verdict.subject.name, verdict.right.label, verdict.name
        if verdict.rules:
            ids = " and ".join(dict.fromkeys(rule.id for rule in verdict.rules))
            alternative = self.decide_without(verdict)
            return [f"without {ids} it would be {alternative.effect}{_deciding_rules(alternative)}"]
        rule = f"an allow rule for {subject} with {right}: [{name}]"
        return [f"{rule} would change it"]

    def _evaluate(self, subject: Subject, right: Right, name: str, found: list[Hit]) -> Verdict:
        base = Verdict(Effect.DENY, subject, right, name)
        if tail_base(name) not in (None, subject.name if subject.tail else None):
            return base
        partly: list[Hit] = []  # of a pattern or a tree: what restricts or shortens a part of it
        for effect in _STRENGTH:
            matching = sorted((hit for hit in found if hit[0].effect is effect), key=_order)
            if matching and (effect is Effect.DENY or _complete(matching, right, name)):
                return _verdict(base, effect, sorted([*matching, *partly], key=_order))
            partly += (hit for hit in matching if right & TREE_RIGHTS or hit[1].lines())
        default, lasting = self.policy.defaults, [rule for rule, _ in partly]
        if default.decision is Effect.DENY:
            return replace(base, lifetime=default.lifetime, renew_until=default.renew_until)
        return replace(
            base,
            effect=default.decision,
            clauses=tuple(clause for _, clause in partly),
            lifetime=min((default.lifetime, *(rule.lifetime for rule in lasting))),
            renew_until=min((default.renew_until, *(rule.renew_until for rule in lasting))),
        )


def _order(hit: Hit) -> tuple[str, str]:
    return hit[0].id, hit[1].pattern


def _complete(matching: Iterable[Hit], right: Right, name: str) -> bool:
    """Whether some rule gives the *whole* request; others only add their restrictions."""
    return any(gives(clause.pattern, right, name) for _, clause in matching)


def _verdict(base: Verdict, effect: Effect, matching: Collection[Hit]) -> Verdict:
    rules = tuple(rule for rule, _ in matching)
    return replace(
        base,
        effect=effect,
        rules=rules,
        clauses=tuple(clause for _, clause in matching),
        lifetime=min(rule.lifetime for rule in rules),
        renew_until=min(rule.renew_until for rule in rules),
    )


def restriction_lines(verdict: Verdict) -> list[str]:
    """The restrictions and the validity as text."""
    lines = [line for restriction in verdict.restrictions for line in restriction.lines()]
    if verdict.rate is not None:
        lines.append(rate_text(verdict.rate))
    if verdict.keep_when_stale:
        lines.append(KEEP_WHEN_STALE)
    renewed = f", renewed until {span(verdict.renew_until)}" if verdict.renew_until else ""
    return [*dict.fromkeys(lines), f"valid {span(verdict.lifetime)}{renewed}"]


def span(seconds: int) -> str:
    """Seconds in the notation of a policy: `7d`, `90s`."""
    for size, unit in ((DAY, "d"), (HOUR, "h"), (MINUTE, "m")):
        if seconds and seconds % size == 0:
            return f"{seconds // size}{unit}"
    return f"{seconds}s"


def _deciding_rules(verdict: Verdict) -> str:
    ids = " and ".join(dict.fromkeys(rule.id for rule in verdict.rules))
    return f", by {ids}" if ids else ", by default"


def _near_miss(rule: PolicyRule, verdict: Verdict) -> str:
    """Why an allowing rule did not match, if it differs in one point only."""
    if rule.effect is Effect.DENY:
        return ""
    clauses = [each for c in rule.clauses if (each := c.of(verdict.subject)) is not None]
    on_name = [c for c in clauses if overlaps(c.pattern, verdict.right, verdict.name)]
    given = [clause for clause in on_name if clause.right is verdict.right]
    if not rule.applies_to(verdict.subject):
        if not given:
            return ""
        other_key = any(
            who.matches(replace(verdict.subject, key=who.key or b"")) for who in rule.who
        )
        prefix = "another key of " if other_key else ""
        return f"rule {rule.id} is for {prefix}{rule.subjects_text}, not {verdict.subject.name}"
    if given:
        return f"rule {rule.id} covers {given[0].shown}, which is not all of {verdict.name}"
    if on_name:
        rights = ", ".join(dict.fromkeys(clause.right.label for clause in on_name))
        return f"rule {rule.id} gives {rights}, not {verdict.right.label}"
    same = [clause.shown for clause in clauses if clause.right is verdict.right]
    return f"rule {rule.id} is for {', '.join(same)}, not {verdict.name}" if same else ""
