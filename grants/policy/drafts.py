"""From verdicts to grants: what the authority may sign for a node, no more than was decided.

A right that the policy restricts in several rules becomes several permissions in one grant, each
with its restriction: the verifier of the grant applies all of them.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from ca.patterns import tail_base
from grants.errors import PolicyRefused
from grants.model import Draft, Permission, Restriction, Right
from grants.policy.decision import Decider, Verdict
from grants.policy.model import Clause, Effect, Subject
from grants.policy.signable import divide
from grants.request import RequestedRight


@dataclass(frozen=True)
class Plan:
    """The rights a node requests, by decision."""

    allowed: tuple[Verdict, ...]
    prompted: tuple[Verdict, ...]
    denied: tuple[Verdict, ...]


def plan(decider: Decider, subject: Subject, rights: Iterable[RequestedRight]) -> Plan:
    """Decide on every requested right separately.

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
    """The verdict after a person approved it; its restrictions stay.

    Raises:
        PolicyRefused: the policy denies it: a denial cannot be approved.
    """
    if verdict.effect is Effect.DENY:
        reason = verdict.rules[0].reason if verdict.rules else "no rule allows it"
        raise PolicyRefused(
            f"the policy denies {verdict.right.label} {verdict.name}: {reason}",
            "to allow it, change the policy first",
        )
    return replace(verdict, effect=Effect.ALLOW)


def approximate(verdict: Verdict, restriction: Restriction) -> Verdict:
    """The verdict, additionally restricted by `restriction`.

    Raises:
        PolicyRefused: not a subscription.
    """
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
    verdicts: Iterable[Verdict],
    *,
    domain: str,
    now: int,
    serial: Callable[[], bytes],
    skew: int = 0,
) -> list[Draft]:
    """The drafts to sign for allowed verdicts: for each subject and validity, as few as fit.

    Tail patterns have drafts of their own, as a verifier that does not know them refuses a grant.

    `skew`: seconds by which they are backdated, for hosts whose clock is behind.

    Raises:
        PolicyRefused: a verdict other than ALLOW.
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
            domain=domain, subject=subject.name, holder=subject.key, not_before=now - skew,
            expires=now + lifetime, cap=now + max(lifetime, renew), serial=serial(),
            permissions=tuple(item for verdict in part for item in permissions(verdict)),
        )
        for (subject, lifetime, renew, _), group in groups.items()
        for part in divide(group, permissions)
    ]  # fmt: skip


def permissions(verdict: Verdict) -> list[Permission]:
    """The permissions of a grant for `verdict`."""
    restrictions: list[Restriction | None] = list(verdict.restrictions) or [None]
    if verdict.rate is not None:
        restrictions = [_limited(item, verdict.rate) for item in restrictions]
    if verdict.keep_when_stale:
        restrictions = [_keep_when_stale(item) for item in restrictions]
    return [Permission(verdict.name, verdict.right, item) for item in restrictions]


def _keep_when_stale(restriction: Restriction | None) -> Restriction:
    base = Restriction(keep_when_stale=True)
    return base if restriction is None else replace(restriction, keep_when_stale=True)


def _limited(restriction: Restriction | None, rate: float) -> Restriction:
    return Restriction(rate=rate) if restriction is None else replace(restriction, rate=rate)
