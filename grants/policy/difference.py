"""The difference between what a policy wants for one node and the grants it has.

A grant that says exactly what the policy says is kept, byte for byte, whoever asked for it. A grant
of the policy that says anything else goes whole, and what is wanted and in no kept grant is signed
anew: one grant for each set of rules, so that a changed rule touches no other grant. Each kept or
signed grant alone gives no more than the policy: a peer presents only the grants it chooses.
Grants made by hand are left alone; what they give against a denial is a contradiction.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from ca.patterns import tail_base
from grants.errors import PolicyRefused
from grants.model import Grant, Permission, Right
from grants.policy.changes import Before, Change, change_of, kept, withdrawn
from grants.policy.model import Effect, PolicyRule, Subject
from grants.policy.wanted import Atom, Wanted, WantedRight, WantedState, Withheld

# Below what a node presents: it has grants by hand too, and both of a renewal for a while.
MAX_GRANTS: Final = 24  # with more, rules with the same validity share a grant
MAX_PRESENTED: Final = 64
MAX_ENTRIES: Final = 64  # of one grant
_MAX_TEXT: Final = 8 * 1024  # of one grant as text, which is longer than its encoding


class RecordedGrant(NamedTuple):
    """A grant in force; `rules` are the rules it came from, empty if it was made by hand."""

    grant: Grant
    rules: str = ""


class Contradiction(NamedTuple):
    """A right of a grant made by hand which `rule` denies."""

    grant: Grant
    right: Right
    pattern: str
    rule: PolicyRule


@dataclass(frozen=True)
class NodeDifference:
    """What applying the policy changes for one node.

    Args:
        changes: each right on each pattern, also those that are kept.
        sign: the grants to sign, each as the rights in it.
        revoke: the grants that go.
        due: kept grants of which two thirds of the time are over, and that nothing replaces.
        ends: when the first of its rights from the policy ends, seconds; None without any.
    """

    subject: Subject
    changes: tuple[Change, ...] = ()
    sign: tuple[tuple[WantedRight, ...], ...] = ()
    revoke: tuple[Grant, ...] = ()
    due: tuple[Grant, ...] = ()
    ends: int | None = None
    withheld: tuple[Withheld, ...] = ()
    contradictions: tuple[Contradiction, ...] = ()


@dataclass(frozen=True)
class Moment:
    """When and how the difference is made.

    Args:
        now: seconds since the epoch.
        skew: seconds by which grants are backdated.
        renews: whether the master can renew grants now: then they end with their cap.
        renew_due: sign anew what is due.
    """

    now: int
    skew: int = 0
    renews: bool = False
    renew_due: bool = False

    def end(self, grant: Grant) -> int:
        """When `grant` ends, if nothing else is signed."""
        return grant.cap if self.renews else grant.expires

    def end_of(self, wanted: WantedRight) -> int:
        """When a grant signed now for `wanted` ends."""
        longest = max(wanted.lifetime, wanted.renew_until)
        return self.now + (longest if self.renews else wanted.lifetime)

    def is_due(self, grant: Grant) -> bool:
        """Whether two thirds of its time are over."""
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

    Args:
        recorded: of the key of `subject`, not revoked, and not past their caps.
        gets: whether it may get grants; a node without a valid identity only loses some.
    """
    wanted = state.of(subject) if gets else Wanted()
    grants = list(recorded)
    ours = [item.grant for item in grants if item.rules]
    exact = [grant for grant in ours if _is_exact(state, subject, grant, moment.skew)]
    gone = [grant for grant in ours if grant not in exact]
    held = [grant for grant in exact if moment.now < moment.end(grant)]
    lasting = [grant for grant in held if not (moment.renew_due and moment.is_due(grant))]
    rights = {each.atom: each for each in wanted.rights}
    if gets:
        rights |= _still_allowed(state, subject, gone, rights)
    satisfied = {atom for grant in lasting for atom in atoms(grant)}
    sign = _groups(each for atom, each in rights.items() if atom not in satisfied)
    if sign and len(lasting) + len(sign) > MAX_GRANTS:
        sign, gone, held, lasting = _groups(rights.values(), by_rules=False), ours, [], []
    _check_number(subject, len(lasting) + len(sign))
    new = {each.atom for group in sign for each in group}
    ending = [grant for grant in held if not new >= atoms(grant).keys()]
    ends = [moment.end(grant) for grant in ending] + [moment.end_of(group[0]) for group in sign]
    return NodeDifference(
        subject,
        tuple(_changes(state, subject, rights, held, gone, moment.skew)),
        tuple(sign),
        tuple(gone),
        tuple(_due(ending, moment)),
        min(ends, default=None),
        wanted.withheld,
        tuple(_contradictions(state, subject, grants)),
    )


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
    """Whether the policy decides each right of `grant` exactly as it says, for as long."""
    for atom, entries in atoms(grant).items():
        verdict = state.decide(subject, atom)
        if verdict.effect is not Effect.ALLOW:
            return False
        wanted = WantedRight.of(verdict)
        if frozenset(wanted.permissions) != entries or not _lasts(wanted, grant, skew):
            return False
    return True


def _lasts(wanted: WantedRight, grant: Grant, skew: int) -> bool:
    """Whether the grant has the validity of the rules."""
    renewal = max(wanted.lifetime, wanted.renew_until)
    begin = grant.not_before + skew
    return (grant.expires - begin, grant.cap - begin) == (wanted.lifetime, renewal)


def _still_allowed(
    state: WantedState, subject: Subject, gone: Iterable[Grant], wanted: Mapping[Atom, WantedRight]
) -> dict[Atom, WantedRight]:
    """What grants that go gave on request, and the policy allows otherwise than before."""
    asked = {atom for grant in gone for atom in atoms(grant)} - wanted.keys()
    verdicts = (state.decide(subject, atom) for atom in sorted(asked))
    found = [WantedRight.of(verdict) for verdict in verdicts if verdict.effect is Effect.ALLOW]
    return {each.atom: each for each in found}


def _due(ending: Iterable[Grant], moment: Moment) -> list[Grant]:
    """The grants that end soon, and whose rights are in no grant that lasts longer."""
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


def _check_number(subject: Subject, number: int) -> None:
    if number > MAX_PRESENTED:
        raise PolicyRefused(
            f"{subject.name} would need {number} grants where at most {MAX_PRESENTED} are allowed",
            "give patterns instead of names in the rules for it",
        )


def _groups(
    rights: Iterable[WantedRight], *, by_rules: bool = True
) -> list[tuple[WantedRight, ...]]:
    """The rights by grant: those of the same rules and validity, at most `MAX_ENTRIES` each.

    Tail patterns have grants of their own: a verifier that does not know them refuses the grant.
    """
    groups: dict[tuple[str, int, int, bool], list[WantedRight]] = {}
    for each in rights:
        rules, tail = each.rule_ids if by_rules else "", tail_base(each.pattern) is not None
        groups.setdefault((rules, each.lifetime, each.renew_until, tail), []).append(each)
    return [part for group in groups.values() for part in _parts(group)]


def _parts(group: list[WantedRight]) -> Iterator[tuple[WantedRight, ...]]:
    part: list[WantedRight] = []
    size = entries = 0
    for each in group:
        text = sum(len(repr(item)) for item in each.permissions)
        entries += len(each.permissions)
        size += text
        if part and (entries > MAX_ENTRIES or size > _MAX_TEXT):
            yield tuple(part)
            part, size, entries = [], text, len(each.permissions)
        part.append(each)
    yield tuple(part)


def _changes(
    state: WantedState,
    subject: Subject,
    rights: Mapping[Atom, WantedRight],
    held: list[Grant],
    gone: list[Grant],
    skew: int,
) -> Iterator[Change]:
    before = {atom: each for grant in gone for atom, each in _before(grant, skew)}
    now = {atom for grant in held for atom in atoms(grant)}
    for atom, each in rights.items():
        yield kept(subject, each) if atom in now else change_of(subject, each, before.get(atom))
    for atom in sorted(now - rights.keys()):
        yield kept(subject, WantedRight.of(state.decide(subject, atom)))
    for atom in sorted(before.keys() - rights.keys() - now):
        yield withdrawn(subject, atom, state.decide(subject, atom), before[atom])


def _before(grant: Grant, skew: int) -> Iterator[tuple[Atom, Before]]:
    begin = grant.not_before + skew
    for atom, entries in atoms(grant).items():
        yield atom, Before(entries, grant.expires - begin, grant.cap - begin)


def _contradictions(
    state: WantedState, subject: Subject, grants: Iterable[RecordedGrant]
) -> Iterator[Contradiction]:
    for grant, rules in grants:
        for atom in () if rules else atoms(grant):
            verdict = state.decide(subject, atom)
            if verdict.effect is Effect.DENY and verdict.rules:
                yield Contradiction(grant, *atom, verdict.rules[0])
