"""The effect of a verdict on one message: sent or withheld, and which fields change. Pure.

For answers before anything is granted: the guard of a publisher is built from the verdict, so the
answer is the actual result, not a description of it.
"""

from dataclasses import dataclass

from grants.conditions.compile import compile_condition
from grants.decision import Decision
from grants.errors import GrantError
from grants.filters.codegen import Buffer
from grants.filters.hashing import FILTER_KEY_SIZE, key_names
from grants.filters.layout import Layout
from grants.guard import Guard
from grants.policy.decision import Verdict
from grants.policy.drafts import permissions

_FOREVER = 1 << 53


@dataclass(frozen=True)
class TrialOutcome:
    """`message` is what the receiver gets, or None; then `reason` is set."""

    message: bytes | None
    reason: str = ""


class Trial:
    """One verdict, tried on messages of one layout."""

    def __init__(self, layout: Layout, verdict: Verdict) -> None:
        self._layout = layout
        self._verdict = verdict
        self._reason = "" if verdict else f"{verdict.effect}: {_deciding_rule(verdict)}"
        self._guard: Guard | None = None
        if verdict:
            self._guard = self._build()

    def __call__(self, message: Buffer, now: int) -> TrialOutcome:
        """Try `message` (serialized) at `now`, seconds since the epoch."""
        if self._guard is None:
            return TrialOutcome(None, self._reason)
        try:
            pieces = self._guard(message, now)
        except GrantError as error:
            return TrialOutcome(None, str(error))
        if pieces is None:
            return TrialOutcome(None, self._failed_condition(message, now))
        return TrialOutcome(b"".join(pieces))

    def _build(self) -> Guard | None:
        verdict = self._verdict
        found = (item.restriction for item in permissions(verdict))
        restrictions = tuple(item for item in found if item is not None)
        decision = Decision(verdict.right, verdict.name, (), _FOREVER, restrictions)
        try:
            return Guard(self._layout, decision, _placeholder_keys(verdict))
        except GrantError as error:
            self._reason = str(error)
            return None

    def _failed_condition(self, message: Buffer, now: int) -> str:
        """The reason why the message is withheld: the first condition that is not true."""
        for restriction in self._verdict.restrictions:
            layout = self._layout if restriction.type is not None else None
            for text in restriction.conditions:
                if not compile_condition(layout, text)(message, now):
                    return f"the condition is not true: {text}"
        slots = [item.slot for item in self._verdict.restrictions if item.slot is not None]
        if slots:
            return f"not the one message at the start of each {max(slots)} s"
        rate = self._verdict.rate
        return "not admitted" if rate is None else f"more than {rate:g} messages a second"


def _placeholder_keys(verdict: Verdict) -> dict[str, bytes]:
    """Keys for pseudonyms in place of the publisher's; the result has the same form."""
    rules = (rule for item in verdict.restrictions for rule in item.filters)
    return {name: bytes(FILTER_KEY_SIZE) for name in key_names(rules)}


def _deciding_rule(verdict: Verdict) -> str:
    return verdict.rules[0].reason if verdict.rules else "no rule matches"
