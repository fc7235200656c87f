"""From verdicts to grants: what the authority may sign for a node, no more than was decided.

A right that the policy restricts in several rules becomes several permissions in one grant, each
with its restriction: whoever checks the grant applies all of them. What this version's grants
cannot express is refused here, never left out.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final

from grants.errors import PolicyRefused
from grants.model import Draft, FilterRule, Permission, Restriction, Right
from grants.policy.decision import Decider, Verdict
from grants.policy.model import Clause, Effect, Policy, Subject

_LIMITED: Final = "rate" in {field.name for field in fields(Restriction)}


@dataclass(frozen=True, order=True)
class Wish:
    """One thing a node asks for: one right on a name or pattern."""

    right: Right
    pattern: str

    def __str__(self) -> str:
        return f"{self.right.label} {self.pattern}"


@dataclass(frozen=True)
class Plan:
    """The wishes of one node, sorted by what the policy says."""

    allowed: tuple[Verdict, ...]
    asked: tuple[Verdict, ...]
    denied: tuple[Verdict, ...]


def plan(decider: Decider, subject: Subject, wishes: Iterable[Wish]) -> Plan:
    """Decide every wish by itself.

    Raises:
        PatternRefused, PolicyRefused: as `Decider.decide`.
    """
    verdicts = [decider.decide(subject, wish.right, wish.pattern) for wish in sorted(set(wishes))]
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


def approximate(policy: Policy, verdict: Verdict, rules: Sequence[FilterRule]) -> Verdict:
    """The same, seen only through `rules`.

    Raises:
        PolicyRefused: not a subscription, or the policy does not say the type of the topic.
    """
    kind = policy.type_of(verdict.name)
    if verdict.right is not Right.SUBSCRIBE or kind is None:
        raise PolicyRefused(
            f"{verdict.right.label} {verdict.name} cannot be approximate",
            "only subscriptions to a topic whose type the policy knows can: add it to types",
        )
    restriction = Restriction(kind, (), tuple(sorted(rules)))
    extra = Clause(verdict.right, verdict.name, restriction, None, kind)
    return replace(verdict, clauses=(*verdict.clauses, extra))


def shorten(verdict: Verdict, seconds: int) -> Verdict:
    """The same for at most `seconds`, not to be renewed."""
    return replace(verdict, lifetime=min(verdict.lifetime, seconds), renew_until=0)


def drafts(
    verdicts: Iterable[Verdict], *, domain: str, now: int, serial: Callable[[], bytes]
) -> list[Draft]:
    """What to sign for allowed verdicts of one subject: one draft per validity.

    Raises:
        PolicyRefused: a verdict that is no yes, or a restriction grants cannot express.
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
    """The entries of a grant that say what `verdict` says.

    Raises:
        PolicyRefused: a rate, where grants know none.
    """
    restrictions: list[Restriction | None] = list(verdict.restrictions) or [None]
    if verdict.rate is not None:
        restrictions = [_limited(item, verdict.rate) for item in restrictions]
    return [Permission(verdict.name, verdict.right, item) for item in restrictions]


def _limited(restriction: Restriction | None, rate: float) -> Restriction:
    if not _LIMITED:
        raise PolicyRefused(
            "the grants of this version know no rate", "take out limit: {rate: ...}"
        )
    limit: dict[str, Any] = {"rate": rate}
    return Restriction(**limit) if restriction is None else replace(restriction, **limit)
