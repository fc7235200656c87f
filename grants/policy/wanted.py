"""What a policy gives a node outright: the wanted state, which `rossec policy apply` makes true.

Each clause of an allowing rule is decided whole, as a request for its pattern would be. Also here: from
verdicts to grants, no more than was decided, and what is in force for a right, whatever the policy says of it
today.
"""

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

from ca.names import is_alias, shown, tail_base
from grants.errors import PolicyRefused
from grants.model import Draft, Grant, Permission, Restriction, Right, format_time
from grants.policy.decision import Decider, Verdict
from grants.policy.model import Clause, Effect, Policy, PolicyRule, Subject
from grants.policy.names import gives, intersects, is_own, overlaps
from grants.policy.restrictions import divide
from grants.policy.rules import is_basics
from grants.request import RequestedRight


@dataclass(frozen=True)
class Plan:
    allowed: tuple[Verdict, ...]
    prompted: tuple[Verdict, ...]
    denied: tuple[Verdict, ...]


def plan(decider: Decider, subject: Subject, rights: Iterable[RequestedRight]) -> Plan:
    verdicts = [decider.decide(subject, each.right, each.pattern) for each in sorted(set(rights))]
    by = {effect: tuple(v for v in verdicts if v.effect is effect) for effect in Effect}
    return Plan(by[Effect.ALLOW], by[Effect.PROMPT], by[Effect.DENY])


def approve(verdict: Verdict) -> Verdict:
    """The verdict after a person approved it; its restrictions stay."""
    if verdict.effect is Effect.DENY:
        reason = verdict.rules[0].reason if verdict.rules else "no rule allows it"
        raise PolicyRefused(
            f"the policy denies {verdict.right.label} {verdict.name}: {reason}",
            "to allow it, change the policy first",
        )
    return replace(verdict, effect=Effect.ALLOW)


def approximate(verdict: Verdict, restriction: Restriction) -> Verdict:
    """The verdict, additionally restricted by `restriction`."""
    if verdict.right is not Right.SUBSCRIBE:
        raise PolicyRefused(
            f"{verdict.right.label} {verdict.name} cannot be approximate", "only subscriptions can"
        )
    base = replace(restriction, rate=None)
    extra = Clause(verdict.right, verdict.name, base, restriction.rate, restriction.type)
    return replace(verdict, clauses=(*verdict.clauses, extra))


def shorten(verdict: Verdict, seconds: int) -> Verdict:
    """The verdict for at most `seconds`, without renewal."""
    return replace(verdict, lifetime=min(verdict.lifetime, seconds), renew_until=0)


def limit(verdict: Verdict, seconds: int) -> Verdict:
    """The verdict for at most `seconds`, its renewals included."""
    renew = min(verdict.renew_until, seconds)
    return replace(verdict, lifetime=min(verdict.lifetime, seconds), renew_until=renew)


def drafts(
    verdicts: Iterable[Verdict], *, domain: str, now: int, serial: Callable[[], bytes], skew: int = 0
) -> list[Draft]:
    """The drafts to sign for allowed verdicts: for each subject and validity, as few as fit.

    Tail patterns have drafts of their own, as a verifier that does not know them refuses a grant.

    `skew`: seconds by which they are backdated, for hosts whose clock is behind.
    """
    groups: dict[tuple[Subject, int, int, bool], list[Verdict]] = {}
    for verdict in verdicts:
        if verdict.effect is not Effect.ALLOW:
            raise PolicyRefused(f"not allowed: {verdict.headline}", "only ALLOW can be signed")
        tail = tail_base(verdict.name) is not None
        key = (verdict.subject, verdict.lifetime, verdict.renew_until, tail)
        groups.setdefault(key, []).append(verdict)
    return [
        Draft(
            domain=domain,
            subject=subject.name,
            holder=subject.key,
            not_before=now - skew,
            expires=now + lifetime,
            cap=now + max(lifetime, renew),
            serial=serial(),
            permissions=tuple(item for verdict in part for item in permissions(verdict)),
        )
        for (subject, lifetime, renew, _), group in groups.items()
        for part in divide(group, permissions)
    ]


def permissions(verdict: Verdict) -> list[Permission]:
    """The permissions of a grant for `verdict`."""
    # Several restrictions become several entries of one grant: its verifier applies all of them.
    more: dict[str, Any] = {} if verdict.rate is None else {"rate": verdict.rate}
    if verdict.keep_when_stale:
        more["keep_when_stale"] = True
    restrictions = [replace(item, **more) for item in verdict.restrictions]
    if not restrictions:
        return [Permission(verdict.name, verdict.right, Restriction(**more) if more else None)]
    return [Permission(verdict.name, verdict.right, item) for item in restrictions]


Atom = tuple[Right, str]  # one right on one name or pattern
_Key = tuple[bool | str | int, ...]


@dataclass(frozen=True)
class WantedRight:
    """One right on one pattern, as the policy gives it."""

    right: Right
    pattern: str
    permissions: tuple[Permission, ...]  # the entries of a grant that say so; all of them hold together
    rules: tuple[PolicyRule, ...]  # those that decide
    lifetime: int  # seconds
    renew_until: int  # 0 is never

    @classmethod
    def of(cls, verdict: Verdict) -> "WantedRight":
        """What a verdict of ALLOW gives."""
        return cls(
            verdict.right,
            verdict.name,
            tuple(permissions(verdict)),
            tuple(dict.fromkeys(verdict.rules)),
            verdict.lifetime,
            0 if is_alias(verdict.subject.name) else verdict.renew_until,
        )

    @property
    def atom(self) -> Atom:
        return self.right, self.pattern


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
        """What the policy gives `subject` outright."""
        rules, key = self._rules_of(subject)
        if key not in self._wanted:
            rights: dict[Atom, WantedRight] = {}
            withheld: dict[tuple[Atom, str], Withheld] = {}
            for rule, atom in _clauses(rules, subject):
                verdict = self._decider.decide_by(rules, subject, *atom)
                # What a person decides is left to a person, and a pattern of which one name is denied is
                # withheld whole: a grant cannot say "except".
                if verdict.effect is Effect.ALLOW:
                    rights.setdefault(atom, WantedRight.of(verdict))
                else:
                    found = Withheld(*atom, verdict.effect, rule, verdict.rules[0])
                    withheld.setdefault((atom, rule.id), found)
            self._wanted[key] = Wanted(tuple(rights.values()), tuple(withheld.values()))
        return self._wanted[key]

    def decide(self, subject: Subject, atom: Atom) -> Verdict:
        """As `Decider.decide`, of a right and a pattern that were checked before."""
        rules, key = self._rules_of(subject)
        if (key, atom) not in self._verdicts:
            self._verdicts[key, atom] = self._decider.decide_by(rules, subject, *atom)
        return replace(self._verdicts[key, atom], subject=subject)

    def _rules_of(self, subject: Subject) -> tuple[list[PolicyRule], _Key]:
        if self._last[0] != subject:
            rules = self._decider.rules_of(subject)
            # No master renews grants of foreigners, so they share nothing with own nodes.
            own_names = any(is_own(clause.pattern) for rule in rules for clause in rule.clauses)
            own = (subject.name,) if subject.tail or own_names else ()
            key = (is_alias(subject.name), subject.tail, *own, *map(id, rules))
            self._last = (subject, rules, key)
        return self._last[1:]


def rule_ids(rules: Iterable[PolicyRule]) -> str:
    """The ids of `rules`, as text."""
    return " ".join(sorted({rule.id for rule in rules}))


def _clauses(rules: list[PolicyRule], subject: Subject) -> Iterator[tuple[PolicyRule, Atom]]:
    for rule in rules:
        if rule.effect is not Effect.DENY:
            for clause in rule.clauses:
                if (found := clause.of(subject)) is not None:
                    yield rule, (found.right, found.pattern)


def in_force(
    grants: Iterable[Grant],
    keys: Collection[bytes],
    right: Right,
    name: str,
    *,
    now: int,
    revoked: Collection[bytes],
) -> list[Grant]:
    """The grants by which a node can use `right` on `name`, or on a part of it, at `now`.

    One signed by hand, or before a rule was changed, is accepted by every verifier until it ends or is
    revoked, whatever the policy says today. `keys`: those the node may prove to hold; `revoked`: ids of
    grants and keys.
    """
    return [
        grant
        for grant in grants
        if grant.holder in keys
        and grant.not_before <= now < grant.expires
        and grant.holder not in revoked
        and not any(entry in revoked for entry in grant.revocable)
        and _each_link(grant, right, name, overlaps)
    ]


def _each_link(grant: Grant, right: Right, name: str, fits: Callable[[str, Right, str], bool]) -> bool:
    # A narrowed grant gives what all links of its chain give.
    return all(
        any(right in each.rights and fits(each.pattern, right, name) for each in link.permissions)
        for link in grant.links
    )


def in_force_lines(found: Iterable[Grant], verdict: Verdict) -> list[str]:
    """What is in force, for people; if the policy does not allow it, that is said."""
    said = held_lines(found, verdict.right, verdict.name)
    if said and not verdict:
        return [*said, "the policy does not allow what these grants still give: apply or revoke"]
    return said


def held_lines(found: Iterable[Grant], right: Right, name: str) -> list[str]:
    """What grants in force give of a right, a line each."""
    lines: list[str] = []
    for grant in found:
        near = [x for x in grant.permissions if right in x.rights and overlaps(x.pattern, right, name)]
        whole = any(gives(each.pattern, right, name) for each in near)
        what = ", ".join(dict.fromkeys(shown(each.pattern) for each in near))
        part = "" if whole else ", a part of it,"
        how = ", with restrictions" if any(each.is_narrowed for each in near) else ""
        until = format_time(grant.expires)
        lines.append(f"in force: grant {grant.short_id} gives {right.label} {what}{part} until {until}{how}")
    return lines


def gives_whole(found: Iterable[Grant], right: Right, name: str) -> bool:
    """Whether one of these grants gives all of `name`, a name or a pattern."""
    return any(_each_link(grant, right, name, gives) for grant in found)


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
