"""From verdicts to grants: what the authority may sign for a node, no more than was decided.

A right that the policy restricts in several rules becomes several permissions in one grant, each
with its restriction: whoever checks the grant applies all of them.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from grants.errors import PolicyRefused
from grants.model import Draft, Permission, Restriction, Right
from grants.policy.decision import Decider, Verdict
from grants.policy.model import Clause, Effect, Subject
from grants.request import RequestedRight


@dataclass(frozen=True)
class Plan:
    """The rights a node requests, sorted by what the policy says."""

    allowed: tuple[Verdict, ...]
    asked: tuple[Verdict, ...]
    denied: tuple[Verdict, ...]


def plan(decider: Decider, subject: Subject, rights: Iterable[RequestedRight]) -> Plan:
    """Decide every wish by itself.

    Raises:
        PatternRefused, PolicyRefused: as `Decider.decide`.
    """
    verdicts = [
        decider.decide(subject, requested.right, requested.pattern)
        for requested in sorted(set(rights))
    ]
    by = {effect: tuple(v for v in verdicts if v.effect is effect) for effect in Effect}
    return Plan(by[Effect.ALLOW], by[Effect.PROMPT], by[Effect.DENY])


def approve(verdict: Verdict) -> Verdict:
    """A person said yes to what the policy wanted asked; its restrictions stay.

    Raises:
        PolicyRefused: the policy denies it: no person is asked over a denial.
    """
    if verdict.effect is Effect.DENY:
        reason = verdict.rules[0].reason if verdict.rules else "no rule allows it"
        raise PolicyRefused(
            f"the policy denies {verdict.right.label} {verdict.name}: {reason}",
            "change the policy first, if it must be",
        )
    return replace(verdict, effect=Effect.ALLOW)


def approximate(verdict: Verdict, restriction: Restriction) -> Verdict:
    """The same, restricted by `restriction` as well.

    Raises:
        PolicyRefused: not a subscription.
    """
    if verdict.right is not Right.SUBSCRIBE:
        raise PolicyRefused(
            f"{verdict.right.label} {verdict.name} cannot be approximate", "only subscriptions can"
        )
    bare = replace(restriction, rate=None)
    extra = Clause(verdict.right, verdict.name, bare, restriction.rate, restriction.type)
    return replace(verdict, clauses=(*verdict.clauses, extra))


def shorten(verdict: Verdict, seconds: int) -> Verdict:
    """The same for at most `seconds`, not to be renewed."""
    return replace(verdict, lifetime=min(verdict.lifetime, seconds), renew_until=0)


def drafts(
    verdicts: Iterable[Verdict], *, domain: str, now: int, serial: Callable[[], bytes]
) -> list[Draft]:
    """What to sign for allowed verdicts of one subject: one draft per validity.

    Raises:
        PolicyRefused: a verdict that is no yes.
    """
    groups: dict[tuple[Subject, int, int], list[Verdict]] = {}
    for verdict in verdicts:
        if verdict.effect is not Effect.ALLOW:
            raise PolicyRefused(f"not allowed: {verdict.headline}", "only a yes can be signed")
        key = (verdict.subject, verdict.lifetime, verdict.renew_until)
        groups.setdefault(key, []).append(verdict)
    return [
        Draft(
            domain=domain, subject=subject.name, holder=subject.key, not_before=now,
            expires=now + lifetime, cap=now + max(lifetime, renew), serial=serial(),
            permissions=tuple(item for verdict in group for item in permissions(verdict)),
        )
        for (subject, lifetime, renew), group in groups.items()
    ]  # fmt: skip


def permissions(verdict: Verdict) -> list[Permission]:
    """The entries of a grant that say what `verdict` says."""
    restrictions: list[Restriction | None] = list(verdict.restrictions) or [None]
    if verdict.rate is not None:
        restrictions = [_limited(item, verdict.rate) for item in restrictions]
    if verdict.keep_when_stale:
        restrictions = [_kept(item) for item in restrictions]
    return [Permission(verdict.name, verdict.right, item) for item in restrictions]


def _kept(restriction: Restriction | None) -> Restriction:
    bare = Restriction(keep_when_stale=True)
    return bare if restriction is None else replace(restriction, keep_when_stale=True)


def _limited(restriction: Restriction | None, rate: float) -> Restriction:
    return Restriction(rate=rate) if restriction is None else replace(restriction, rate=rate)
