"""The difference between what a policy wants for one node and the grants it has.

A grant that says exactly what the policy says is kept, byte for byte, whoever asked for it. Grants made by
hand are left alone; what they give against a denial is a contradiction.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from math import inf
from typing import Final, NamedTuple

from ca.names import tail_base
from grants.model import KEEP_WHEN_STALE, Grant, Permission, Restriction, Right
from grants.policy.decision import Verdict, validity
from grants.policy.model import Effect, PolicyRule, Subject
from grants.policy.restrictions import divide, why_unsignable
from grants.policy.wanted import Atom, Wanted, WantedRight, WantedState, Withheld, rule_ids


class ChangeKind(StrEnum):
    NEW = "new"
    NARROWER = "narrower"
    WIDER = "wider"
    CHANGED = "changed"
    GONE = "no longer allowed"
    KEPT = "kept"

    @property
    def sign(self) -> str:
        return {ChangeKind.NEW: "+", ChangeKind.GONE: "-", ChangeKind.KEPT: "="}.get(self, "~")


@dataclass(frozen=True)
class Change:
    """One right on one pattern for one node, before and after a policy is applied."""

    kind: ChangeKind
    subject: Subject
    right: Right
    pattern: str
    restrictions: tuple[str, ...]  # as text, with the validity; of the new grant, or of the one that goes
    rules: tuple[PolicyRule, ...] = ()  # that decide, or deny it now; none if none allows it any more
    before: tuple[str, ...] = ()  # what it was as text, where it is changed


class Before(NamedTuple):
    """A right in a grant that goes: its entries, and how long it was given for, in seconds."""

    entries: frozenset[Permission]
    lifetime: int
    longest: int


def change_of(
    subject: Subject, wanted: WantedRight, before: "Before | None" = None, *, is_kept: bool = False
) -> Change:
    if before is None or is_kept:
        return Change(
            ChangeKind.KEPT if is_kept else ChangeKind.NEW, subject, *wanted.atom, _text(wanted), wanted.rules
        )
    longest = max(wanted.lifetime, wanted.renew_until)
    new = _measure(wanted.permissions, wanted.lifetime, longest)
    old = _measure(before.entries, before.lifetime, before.longest)
    was = () if old == new else (*_lines(before.entries), _validity(before.lifetime, before.longest))
    # Wider and narrower is what is certain: one set of restrictions includes the other, no rate or time is
    # higher.
    if old.allows(new):
        kind = ChangeKind.KEPT if new.allows(old) else ChangeKind.NARROWER
    else:
        kind = ChangeKind.WIDER if new.allows(old) else ChangeKind.CHANGED
    return Change(kind, subject, *wanted.atom, _text(wanted), wanted.rules, was)


def withdrawn(subject: Subject, atom: Atom, verdict: Verdict, before: Before) -> Change:
    rules = tuple(dict.fromkeys(verdict.rules))
    return Change(ChangeKind.GONE, subject, *atom, _lines(before.entries), rules)


def _lines(entries: Iterable[Permission]) -> tuple[str, ...]:
    return tuple(sorted({line for item in entries for line in item.lines()}))


def _text(wanted: WantedRight) -> tuple[str, ...]:
    return (*_lines(wanted.permissions), _validity(wanted.lifetime, wanted.renew_until))


def _validity(lifetime: int, longest: int) -> str:
    return validity(lifetime, longest if longest > lifetime else 0)


class _Measure(NamedTuple):
    facts: frozenset[str]
    rate: float
    keeps: bool
    lifetime: int
    longest: int

    def allows(self, other: "_Measure") -> bool:
        return self.facts <= other.facts and self[1:] == tuple(map(max, self[1:], other[1:]))


def _measure(entries: Iterable[Permission], lifetime: int, longest: int) -> _Measure:
    found = [item.restriction for item in entries]
    rates = [item.rate for item in found if item is not None and item.rate is not None]
    keeps = bool(found) and all(item is not None and item.keep_when_stale for item in found)
    facts = frozenset(fact for item in found if item is not None for fact in _facts(item))
    return _Measure(facts, min(rates, default=inf), keeps, lifetime, longest)


def _facts(restriction: Restriction) -> Iterator[str]:
    if restriction.type is not None:
        yield f"only {restriction.type}"
    for line in restriction.lines():
        if line != KEEP_WHEN_STALE and not line.startswith("at most "):
            yield line


# Below what a node presents: it has grants by hand too, and both of a renewal for a while.
MAX_GRANTS: Final = 24  # with more, rules with the same validity share a grant
MAX_PRESENTED: Final = 64


class RecordedGrant(NamedTuple):
    """A grant in force; `rules` are the rules it came from, empty if it was made by hand."""

    grant: Grant
    rules: str = ""


class Contradiction(NamedTuple):
    # A right of a grant made by hand which `rule` denies.
    grant: Grant
    right: Right
    pattern: str
    rule: PolicyRule


@dataclass(frozen=True)
class NodeDifference:
    """What applying the policy changes for one node."""

    subject: Subject
    changes: tuple[Change, ...] = ()  # each right on each pattern, also those that are kept
    sign: tuple[tuple[WantedRight, ...], ...] = ()  # the grants to sign, each as the rights in it
    revoke: tuple[Grant, ...] = ()  # the grants that go
    # Of these, what the policy says exactly, and that only shares a grant from now on.
    replaced: tuple[Grant, ...] = ()
    refused: tuple[str, ...] = ()  # why some of what the policy allows is in no grant; all else is done
    due: tuple[Grant, ...] = ()  # kept, with two thirds of the time over, and that nothing replaces
    ends: int | None = None  # when the first of its rights from the policy ends, seconds
    withheld: tuple[Withheld, ...] = ()
    contradictions: tuple[Contradiction, ...] = ()

    @property
    def taken(self) -> tuple[Grant, ...]:
        """The grants that go and of which nothing is signed anew: what is only taken away."""
        new = {each.atom for group in self.sign for each in group}
        return tuple(grant for grant in self.revoke if new.isdisjoint(atoms(grant)))

    def without_signing(self, why: str) -> "NodeDifference":
        """What is left of it where nothing can be signed: what is too much goes all the same."""
        left = tuple(grant for grant in self.revoke if grant not in self.replaced)
        refused = (*self.refused, f"{self.subject.name}: {why}")
        return replace(self, sign=(), revoke=left, replaced=(), refused=refused)

    def without_room(self, room: int, why: str) -> "NodeDifference":
        """What is done where only so many grants can be revoked: what is only taken away, first."""
        refused = (*self.refused, f"{self.subject.name}: {why}")
        return replace(self, sign=(), revoke=self.taken[:room], replaced=(), refused=refused)


@dataclass(frozen=True)
class Moment:
    """When and how the difference is made; times in seconds."""

    now: int
    skew: int = 0  # by which grants are backdated
    renews: bool = False  # whether the master can renew grants now: then they end with their cap
    renew_due: bool = False  # sign anew what is due
    renewed_until: int | None = None  # when that ends, if it is known; nothing is renewed beyond it

    def end(self, grant: Grant) -> int:
        return self._end(grant.expires, grant.cap)

    def end_of(self, wanted: WantedRight) -> int:
        longest = max(wanted.lifetime, wanted.renew_until)
        return self._end(self.now + wanted.lifetime, self.now + longest)

    def _end(self, expires: int, cap: int) -> int:
        if not self.renews:
            return expires
        return cap if self.renewed_until is None else max(expires, min(cap, self.renewed_until))

    def is_due(self, grant: Grant) -> bool:
        begin, end = grant.not_before + self.skew, self.end(grant)
        return self.now >= begin + (end - begin) * 2 // 3


def difference(
    state: WantedState,
    subject: Subject,
    recorded: Iterable[RecordedGrant],
    moment: Moment,
    *,
    gets: bool = True,
) -> NodeDifference:
    """Compare what the policy wants for `subject` with its grants.

    `recorded`: of the key of `subject`, not revoked, and not past their caps. A node without a valid identity
    `gets` nothing, and only loses some.
    """
    wanted = state.of(subject) if gets else Wanted()
    grants = list(recorded)
    ours = [item.grant for item in grants if item.rules]
    chosen = _choose(state, subject, wanted, ours, moment, gets=gets)
    new = {each.atom for group in chosen.sign for each in group}
    ending = [grant for grant in chosen.held if not new >= atoms(grant).keys()]
    ends = [moment.end(grant) for grant in ending]
    ends += [moment.end_of(group[0]) for group in chosen.sign]
    return NodeDifference(
        subject,
        tuple(_changes(state, subject, chosen, moment.skew)),
        tuple(chosen.sign),
        tuple(chosen.gone),
        tuple(chosen.replaced),
        tuple(dict.fromkeys(chosen.refused)),
        tuple(_due(ending, moment)),
        min(ends, default=None),
        wanted.withheld,
        tuple(_contradictions(state, subject, grants)),
    )


class _Chosen(NamedTuple):
    rights: dict[Atom, WantedRight]
    sign: list[tuple[WantedRight, ...]]
    gone: list[Grant]
    held: list[Grant]
    replaced: list[Grant]
    refused: list[str]


def _choose(
    state: WantedState, subject: Subject, wanted: Wanted, ours: list[Grant], moment: Moment, *, gets: bool
) -> _Chosen:
    # A grant of the policy that says anything else goes whole: each kept or signed grant alone gives no more
    # than the policy, as a peer presents only the grants it chooses. What is wanted and in no kept one is
    # signed anew, one for each set of rules, so that a changed rule touches no other grant.
    exact = [grant for grant in ours if _is_exact(state, subject, grant, moment.skew)]
    gone = [grant for grant in ours if grant not in exact]
    held = [grant for grant in exact if moment.now < moment.end(grant)]
    lasting = [grant for grant in held if not (moment.renew_due and moment.is_due(grant))]
    rights = {each.atom: each for each in wanted.rights}
    if gets:
        rights |= _still_allowed(state, subject, gone, rights)
    satisfied = {atom for grant in lasting for atom in atoms(grant)}
    refused = list(_drop_unsignable(subject, rights, satisfied))
    sign = _groups(each for atom, each in rights.items() if atom not in satisfied)
    number = len(lasting) + len(sign)
    if gets and (number > MAX_PRESENTED or (sign and number > MAX_GRANTS)):
        # From all that goes then: also what was given on request, which no rule gives outright.
        every = rights | _still_allowed(state, subject, ours, rights)
        impossible = list(_drop_unsignable(subject, every, frozenset()))
        shared = _groups(every.values(), by_rules=False)
        if not impossible and len(shared) <= min(MAX_PRESENTED, number):
            return _Chosen(every, shared, ours, [], exact, refused)
    room = max(MAX_PRESENTED - len(lasting), 0)
    if len(sign) > room:
        refused.append(
            f"{subject.name} would need {number} grants where at most {MAX_PRESENTED} are allowed:"
            " give patterns instead of names in the rules for it"
        )
        for each in (each for group in sign for each in group):
            del rights[each.atom]
        sign = []
    return _Chosen(rights, sign, gone, held, [], refused)


def atoms(grant: Grant) -> dict[Atom, frozenset[Permission]]:
    """The single rights of a grant, each with all entries that hold together."""
    found: dict[Atom, frozenset[Permission]] = {}
    for item in grant.permissions:
        for right in item.rights:
            single = Permission(item.pattern, right, item.restriction)
            atom = (right, item.pattern)
            found[atom] = found.get(atom, frozenset()) | {single}
    return found


def _is_exact(state: WantedState, subject: Subject, grant: Grant, skew: int) -> bool:
    for atom, entries in atoms(grant).items():
        verdict = state.decide(subject, atom)
        if verdict.effect is not Effect.ALLOW:
            return False
        wanted, begin = WantedRight.of(verdict), grant.not_before + skew
        lasts = (wanted.lifetime, max(wanted.lifetime, wanted.renew_until))
        if frozenset(wanted.permissions) != entries or (grant.expires - begin, grant.cap - begin) != lasts:
            return False
    return True


def _still_allowed(
    state: WantedState, subject: Subject, gone: Iterable[Grant], wanted: Mapping[Atom, WantedRight]
) -> dict[Atom, WantedRight]:
    # What grants that go gave on request, and the policy allows otherwise than before.
    asked = {atom for grant in gone for atom in atoms(grant)} - wanted.keys()
    verdicts = (state.decide(subject, atom) for atom in sorted(asked))
    found = [WantedRight.of(verdict) for verdict in verdicts if verdict.effect is Effect.ALLOW]
    return {each.atom: each for each in found}


def _due(ending: Iterable[Grant], moment: Moment) -> list[Grant]:
    last: dict[Atom, int] = {}
    held = list(ending)
    for grant in held:
        for atom in atoms(grant):
            last[atom] = max(last.get(atom, 0), moment.end(grant))
    return [
        grant
        for grant in held
        if moment.is_due(grant) and any(last[atom] == moment.end(grant) for atom in atoms(grant))
    ]


def _drop_unsignable(
    subject: Subject, rights: dict[Atom, WantedRight], satisfied: Collection[Atom]
) -> Iterator[str]:
    # Take out of `rights` what is to be signed and cannot be; yields why, for each.
    for atom, each in [*rights.items()]:
        if atom not in satisfied and (reason := why_unsignable(each.permissions)):
            del rights[atom]
            what = f"{each.right.label} {each.pattern} (rules {rule_ids(each.rules)})"
            yield f"{subject.name}: {what}: {reason}"


def _groups(rights: Iterable[WantedRight], *, by_rules: bool = True) -> list[tuple[WantedRight, ...]]:
    # Tail patterns have grants of their own: a verifier that does not know them refuses the grant.
    groups: dict[tuple[str, int, int, bool], list[WantedRight]] = {}
    for each in rights:
        rules, tail = rule_ids(each.rules) if by_rules else "", tail_base(each.pattern) is not None
        groups.setdefault((rules, each.lifetime, each.renew_until, tail), []).append(each)
    return [part for group in groups.values() for part in divide(group, lambda right: right.permissions)]


def _changes(state: WantedState, subject: Subject, chosen: _Chosen, skew: int) -> Iterator[Change]:
    rights = chosen.rights
    before = {
        atom: Before(entries, *(end - grant.not_before - skew for end in (grant.expires, grant.cap)))
        for grant in chosen.gone
        for atom, entries in atoms(grant).items()
    }
    now = {atom for grant in chosen.held for atom in atoms(grant)}
    for atom, each in rights.items():
        yield change_of(subject, each, before.get(atom), is_kept=atom in now)
    for atom in sorted(now - rights.keys()):
        yield change_of(subject, WantedRight.of(state.decide(subject, atom)), is_kept=True)
    for atom in sorted(before.keys() - rights.keys() - now):
        yield withdrawn(subject, atom, state.decide(subject, atom), before[atom])


def _contradictions(
    state: WantedState, subject: Subject, grants: Iterable[RecordedGrant]
) -> Iterator[Contradiction]:
    for grant, rules in grants:
        for atom in () if rules else atoms(grant):
            verdict = state.decide(subject, atom)
            if verdict.effect is Effect.DENY and verdict.rules:
                yield Contradiction(grant, *atom, verdict.rules[0])
