"""One right of one node before and after a policy is applied: new, narrower, wider, gone, or kept.

Wider and narrower are compared by what is certain: one set of restrictions includes the other, one
rate or validity is the lower. What is neither is "changed".
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from math import inf
from typing import NamedTuple

from grants.model import KEEP_WHEN_STALE, Permission, Restriction, Right
from grants.policy.decision import Verdict, span
from grants.policy.model import PolicyRule, Subject
from grants.policy.wanted import Atom, WantedRight


class Kind(StrEnum):
    """What happens to a right."""

    NEW = "new"
    NARROWER = "narrower"
    WIDER = "wider"
    CHANGED = "changed"
    GONE = "no longer allowed"
    KEPT = "kept"

    @property
    def sign(self) -> str:
        """One character: `+`, `~`, `-` or `=`."""
        return {Kind.NEW: "+", Kind.GONE: "-", Kind.KEPT: "="}.get(self, "~")


@dataclass(frozen=True)
class Change:
    """One right on one pattern for one node.

    Args:
        restrictions: as text, with the validity; of the new grant, or of the one that goes.
        before: what it was as text, where it is changed.
        rules: those that decide, or that deny it now; none if no rule allows it any more.
    """

    kind: Kind
    subject: Subject
    right: Right
    pattern: str
    restrictions: tuple[str, ...]
    rules: tuple[PolicyRule, ...] = ()
    before: tuple[str, ...] = ()


class Before(NamedTuple):
    """A right in a grant that goes: its entries, and how long it was given for, in seconds."""

    entries: frozenset[Permission]
    lifetime: int
    longest: int

    def lines(self) -> tuple[str, ...]:
        """It as text."""
        return (*_lines(self.entries), _validity(self.lifetime, self.longest))


def kept(subject: Subject, wanted: WantedRight) -> Change:
    """A right that stays as it is."""
    return Change(Kind.KEPT, subject, *wanted.atom, _text(wanted), wanted.rules)


def change_of(subject: Subject, wanted: WantedRight, before: "Before | None" = None) -> Change:
    """A right that is signed: new, or instead of what it was `before`."""
    if before is None:
        return Change(Kind.NEW, subject, *wanted.atom, _text(wanted), wanted.rules)
    longest = max(wanted.lifetime, wanted.renew_until)
    new = _measure(wanted.permissions, wanted.lifetime, longest)
    old = _measure(before.entries, before.lifetime, before.longest)
    kind, was = _kind(old, new), () if old == new else before.lines()
    return Change(kind, subject, *wanted.atom, _text(wanted), wanted.rules, was)


def withdrawn(subject: Subject, atom: Atom, verdict: Verdict, before: Before) -> Change:
    """A right that goes; `verdict` is the decision on it now."""
    rules = tuple(dict.fromkeys(verdict.rules))
    return Change(Kind.GONE, subject, *atom, _lines(before.entries), rules)


def _lines(entries: Iterable[Permission]) -> tuple[str, ...]:
    """The restrictions of entries that hold together, as text."""
    found = [item.restriction for item in entries if item.restriction is not None]
    return tuple(sorted({line for item in found for line in item.lines()}))


def _text(wanted: WantedRight) -> tuple[str, ...]:
    return (*_lines(wanted.permissions), _validity(wanted.lifetime, wanted.renew_until))


def _validity(lifetime: int, longest: int) -> str:
    renewed = f", renewed until {span(longest)}" if longest > lifetime else ""
    return f"valid {span(lifetime)}{renewed}"


class _Measure(NamedTuple):
    """How much is allowed: `facts` narrow it, the others widen it."""

    facts: frozenset[str]
    rate: float
    keeps: bool
    lifetime: int
    longest: int

    def allows(self, other: "_Measure") -> bool:
        """Whether it allows at least what `other` does."""
        return self.facts <= other.facts and self[1:] == tuple(map(max, self[1:], other[1:]))


def _measure(entries: Iterable[Permission], lifetime: int, longest: int) -> _Measure:
    found = [item.restriction for item in entries]
    rates = [item.rate for item in found if item is not None and item.rate is not None]
    keeps = bool(found) and all(item is not None and item.keep_when_stale for item in found)
    facts = frozenset(fact for item in found if item is not None for fact in _facts(item))
    return _Measure(facts, min(rates, default=inf), keeps, lifetime, longest)


def _facts(restriction: Restriction) -> Iterator[str]:
    """What narrows by being there, each alone."""
    if restriction.type is not None:
        yield f"only {restriction.type}"
    for line in restriction.lines():
        if line != KEEP_WHEN_STALE and not line.startswith("at most "):
            yield line


def _kind(old: _Measure, new: _Measure) -> Kind:
    match old.allows(new), new.allows(old):
        case True, False:
            return Kind.NARROWER
        case False, True:
            return Kind.WIDER
        case True, True:
            return Kind.KEPT
        case _:
            return Kind.CHANGED
