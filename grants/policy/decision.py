"""The decision of a policy: deny > allow > prompt > default, and its explanation.

All rules that match are evaluated, whatever their order. An unknown right, an invalid name or no matching
rule is never allowed.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Final, TypeAlias

from ca.names import TAIL, check_name, check_tail_pattern, tail_base
from grants.errors import PolicyRefused
from grants.limits import rate_text
from grants.model import KEEP_WHEN_STALE, TREE_RIGHTS, Restriction, Right, merge
from grants.policy.model import DAY, HOUR, MINUTE, Clause, Effect, Policy, PolicyRule, Subject
from grants.policy.names import check_rule_pattern, gives, is_own, overlaps, resolve, segments

Hit: TypeAlias = tuple[PolicyRule, Clause]

_ANY_NODE: Final = ""
MAX_NEAR_MISSES: Final = 5
_STRENGTH: Final = (Effect.DENY, Effect.ALLOW, Effect.PROMPT)


@dataclass
class _Branch:
    children: dict[str, "_Branch"] = field(default_factory=dict)
    hits: dict[str, list[Hit]] = field(default_factory=dict)  # by exact node name, or _ANY_NODE


# Clauses are found by a tree over the segments of names, so the cost does not grow with the rules; `hits`
# gives the same by comparing every clause: tests compare both, and whole patterns are only looked up with it.
# In a tree node, clauses for one exact node name are found by that name; the others are compared one by one.
# Clauses on own names (`{node}/pose`) are found by the node, and what is found has the pattern that they are
# for it.
class Index:
    def __init__(self, policy: Policy) -> None:
        self._roots: dict[Right, _Branch] = {}
        self._rules: dict[str, dict[int, PolicyRule]] = {}  # by exact node name, or _ANY_NODE
        self._own: dict[tuple[Right, str], list[Hit]] = {}  # likewise
        for at, rule in enumerate(policy.rules):
            for key in _keys(rule):
                self._rules.setdefault(key, {})[at] = rule
            for clause in rule.clauses:
                self._insert(rule, clause)

    def find(self, subject: Subject, right: Right, name: str) -> list[Hit]:
        if is_pattern(name):
            return list(hits(self.rules_of(subject), subject, right, name))
        found: list[Hit] = []
        for key in (subject.name, _ANY_NODE):
            for rule, clause in self._own.get((right, key), ()):
                own = clause.of(subject) if rule.applies_to(subject) else None
                if own is not None and _decides(rule, own, name):
                    found.append((rule, own))
        root = self._roots.get(right)
        return found if root is None else [*found, *self._find(root, subject, right, name)]

    def _find(self, root: _Branch, subject: Subject, right: Right, name: str) -> Iterator[Hit]:
        branches: dict[int, tuple[_Branch, bool]] = {}
        tree = bool(right & TREE_RIGHTS)
        for branch, whole in _reach(root, name, tree=tree):
            _, before = branches.get(id(branch), (branch, False))
            branches[id(branch)] = (branch, whole or before)  # reached by `**` in several ways
        for branch, whole in branches.values():
            for key in (subject.name, _ANY_NODE):
                for rule, clause in branch.hits.get(key, ()):
                    decides = whole or tree or rule.effect is Effect.DENY
                    if decides and rule.applies_to(subject):
                        yield rule, clause

    def rules_of(self, subject: Subject) -> list[PolicyRule]:
        named = {**self._rules.get(_ANY_NODE, {}), **self._rules.get(subject.name, {})}
        return [named[at] for at in sorted(named) if named[at].applies_to(subject)]

    def _insert(self, rule: PolicyRule, clause: Clause) -> None:
        if is_own(clause.pattern):
            for key in _keys(rule):
                self._own.setdefault((clause.right, key), []).append((rule, clause))
            return
        branch = self._roots.setdefault(clause.right, _Branch())
        for segment in segments(clause.pattern):
            branch = branch.children.setdefault(segment, _Branch())
        for key in _keys(rule):
            branch.hits.setdefault(key, []).append((rule, clause))


def hits(rules: Iterable[PolicyRule], subject: Subject, right: Right, requested: str) -> Iterator[Hit]:
    return applied((rule for rule in rules if rule.applies_to(subject)), subject, right, requested)


def applied(rules: Iterable[PolicyRule], subject: Subject, right: Right, requested: str) -> Iterator[Hit]:
    """As `hits`, of rules that apply to `subject`.

    Of a pattern, and of a parameter with all below it, every clause counts that overlaps with it: a
    denial denies it, an allowing one adds its restrictions and its validity; whether all of it is
    allowed is checked in `decision`.
    """
    for rule in rules:
        for clause in rule.clauses:
            found = clause.of(subject) if clause.right is right else None
            if found is not None and _decides(rule, found, requested):
                yield rule, found


def is_pattern(requested: str) -> bool:
    return "*" in requested or TAIL in requested


def _decides(rule: PolicyRule, clause: Clause, requested: str) -> bool:
    if rule.effect is Effect.DENY or is_pattern(requested) or clause.right & TREE_RIGHTS:
        return overlaps(clause.pattern, clause.right, requested)
    return gives(clause.pattern, clause.right, requested)


def _keys(rule: PolicyRule) -> set[str]:
    # A denial by pinned key applies to any name.
    nodes = {who.node for who in rule.who}
    by_key = rule.effect is Effect.DENY and any(who.key is not None for who in rule.who)
    if by_key or any(node is None or "*" in node for node in nodes):
        return {_ANY_NODE}
    return {node for node in nodes if node is not None}


def _reach(root: _Branch, name: str, *, tree: bool) -> Iterator[tuple[_Branch, bool]]:
    # Branches whose pattern covers `name` (True), or is below it (False, trees only).
    states = {(id(root), False): (root, False)}
    for segment in segments(name):
        following: dict[tuple[int, bool], tuple[_Branch, bool]] = {}
        for branch, repeats_here in states.values():
            if tree and branch is not root:
                yield branch, True  # a right to a parent covers its descendants
            for after, repeats in _follow(branch, segment, repeats_here=repeats_here):
                following[id(after), repeats] = (after, repeats)
        states = following
    for branch in {id(branch): branch for branch, _ in states.values()}.values():
        yield branch, True
        if tree:
            yield from _below(branch)


def _follow(branch: _Branch, segment: str, *, repeats_here: bool) -> Iterator[tuple[_Branch, bool]]:
    if repeats_here:
        yield branch, True
    for key in (segment, "*", "**"):
        child = branch.children.get(key)
        if child is not None:
            yield child, key == "**"


def _below(branch: _Branch) -> Iterator[tuple[_Branch, bool]]:
    for child in branch.children.values():
        yield child, False
        yield from _below(child)


@dataclass(frozen=True)
class Verdict:
    """The decision, and everything needed to explain it. True only for ALLOW.

    `restrictions` and `rate` are all that must be applied together, for ALLOW and PROMPT.
    """

    effect: Effect
    subject: Subject
    right: Right
    name: str
    rules: tuple[PolicyRule, ...] = ()  # those that decide, by id; none if the default does
    clauses: tuple[Clause, ...] = ()
    lifetime: int = 0  # seconds, as `renew_until`; the shortest of the deciding rules
    renew_until: int = 0

    def __bool__(self) -> bool:
        return self.effect is Effect.ALLOW

    @property
    def restrictions(self) -> tuple[Restriction, ...]:
        return merge(clause.restriction for clause in self.clauses)

    @property
    def rate(self) -> float | None:
        return min((c.rate for c in self.clauses if c.rate is not None), default=None)

    @property
    def keep_when_stale(self) -> bool:
        return len(self.rules) > 0 and all(rule.keep_when_stale for rule in self.rules)

    @property
    def headline(self) -> str:
        return f"{self.effect.upper()}: {self.subject.name} {self.right.label} {self.name}"


class Decider:
    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self._index = Index(policy)

    def decide(self, subject: Subject, right: Right, name: str) -> Verdict:
        """Evaluate the policy for one right on one name (or a whole pattern).

        `name` may be an own name as a rule has it, `{node}/pose`. A tail pattern is denied to
        every node but that of the tail.
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
        return self._index.rules_of(subject)

    def decide_by(self, rules: Iterable[PolicyRule], subject: Subject, right: Right, name: str) -> Verdict:
        """As `decide`, with all checked before; `rules` are those of the subject (`rules_of`)."""
        if not is_pattern(name):
            return self._evaluate(subject, right, name, self._index.find(subject, right, name))
        return self._evaluate(subject, right, name, list(applied(rules, subject, right, name)))

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
        return [miss for rule in self.policy.rules if (miss := _near_miss(rule, verdict))][:MAX_NEAR_MISSES]

    def changes(self, verdict: Verdict) -> list[str]:
        """The change of the policy that would change the decision."""
        subject, right, name = verdict.subject, verdict.right, verdict.name
        if not verdict.rules:
            return [f"an allow rule for {subject.name} with {right.label}: [{name}] would change it"]
        others = [rule for rule in self.policy.rules if rule not in verdict.rules]
        alternative = self._evaluate(subject, right, name, list(hits(others, subject, right, name)))
        ids, by = (
            " and ".join(dict.fromkeys(rule.id for rule in each.rules)) for each in (verdict, alternative)
        )
        return [f"without {ids} it would be {alternative.effect}, by {by or 'default'}"]

    def _evaluate(self, subject: Subject, right: Right, name: str, found: list[Hit]) -> Verdict:
        base = Verdict(Effect.DENY, subject, right, name)
        if tail_base(name) not in (None, subject.name if subject.tail else None):
            return base
        # One denial overrides everything, and of the allowing rules *all* restrictions apply together, so
        # adding a rule never silently widens what another narrowed.
        partly: list[Hit] = []  # of a pattern or a tree: what restricts or shortens a part of it
        for effect in _STRENGTH:
            matching = sorted((hit for hit in found if hit[0].effect is effect), key=_order)
            # One rule must give the *whole* request; others only add their restrictions.
            whole = effect is Effect.DENY or any(gives(each.pattern, right, name) for _, each in matching)
            if matching and whole:
                rules, clauses = zip(*sorted([*matching, *partly], key=_order), strict=True)
                return replace(
                    base,
                    effect=effect,
                    rules=rules,
                    clauses=clauses,
                    lifetime=min(rule.lifetime for rule in rules),
                    renew_until=min(rule.renew_until for rule in rules),
                )
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


def restriction_lines(verdict: Verdict) -> list[str]:
    """The restrictions and the validity as text."""
    lines = [line for restriction in verdict.restrictions for line in restriction.lines()]
    if verdict.rate is not None:
        lines.append(rate_text(verdict.rate))
    if verdict.keep_when_stale:
        lines.append(KEEP_WHEN_STALE)
    return [*dict.fromkeys(lines), validity(verdict.lifetime, verdict.renew_until)]


def validity(lifetime: int, renew_until: int = 0) -> str:
    """How long a right holds: `valid 7d, renewed until 30d`; 0 is never renewed."""
    return f"valid {span(lifetime)}" + (f", renewed until {span(renew_until)}" if renew_until else "")


def span(seconds: int) -> str:
    """Seconds in the notation of a policy: `7d`, `90s`."""
    for size, unit in ((DAY, "d"), (HOUR, "h"), (MINUTE, "m")):
        if seconds and seconds % size == 0:
            return f"{seconds // size}{unit}"
    return f"{seconds}s"


def _near_miss(rule: PolicyRule, verdict: Verdict) -> str:
    # Why an allowing rule did not match, if it differs in one point only.
    if rule.effect is Effect.DENY:
        return ""
    clauses = [each for c in rule.clauses if (each := c.of(verdict.subject)) is not None]
    on_name = [c for c in clauses if overlaps(c.pattern, verdict.right, verdict.name)]
    given = [clause for clause in on_name if clause.right is verdict.right]
    if not rule.applies_to(verdict.subject):
        if not given:
            return ""
        other_key = any(who.matches(replace(verdict.subject, key=who.key or b"")) for who in rule.who)
        prefix = "another key of " if other_key else ""
        return f"rule {rule.id} is for {prefix}{rule.subjects_text}, not {verdict.subject.name}"
    if given:
        return f"rule {rule.id} covers {given[0].shown}, which is not all of {verdict.name}"
    if on_name:
        rights = ", ".join(dict.fromkeys(clause.right.label for clause in on_name))
        return f"rule {rule.id} gives {rights}, not {verdict.right.label}"
    same = [clause.shown for clause in clauses if clause.right is verdict.right]
    return f"rule {rule.id} is for {', '.join(same)}, not {verdict.name}" if same else ""
