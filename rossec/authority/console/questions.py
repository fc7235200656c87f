"""What nodes ask for, as the policy would grant it: the questions a person answers.

The policy decides first: what it denies is denied, what it allows waits only for the key and is no
question. Looking denies what nobody answered in time, as `rossec grant pending` does.
"""

import contextlib
from collections.abc import Callable, Mapping
from itertools import groupby
from typing import Final

from ca.encoding import Value
from ca.errors import HintedError, StoreError
from grants.claims import scope_of
from grants.filters.presets import PRESETS
from grants.model import Right
from grants.policy.decision import Verdict
from grants.policy.drafts import approve, limit, permissions
from grants.policy.wanted import rule_ids
from rossec.authority.approvals import (
    ApprovalQueue,
    PendingApproval,
    VerdictChange,
    verdict_change,
)
from rossec.authority.console.reading import bounded
from rossec.authority.console.records import to_value
from rossec.authority.console.views import AskedRight, GrantQuestion
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.policyfile import PolicyFile
from rossec.errors import KeyServiceRefused

MAX_SECONDS: Final = 10 * 366 * 86400


class Questions:
    """The operations about what nodes ask for."""

    def __init__(self, work: AuthorityWork) -> None:
        self._work = work

    def handlers(self) -> Mapping[str, Callable[..., Value]]:
        """By the operation."""
        return {"questions": self.questions, "consider": self.consider}

    def questions(self) -> Value:
        """What waits for a person, oldest first; without a policy nothing does.

        Raises:
            PolicyRefused, PathRefused: the policy cannot be used.
        """
        if not self._work.policy_path().exists():
            return []
        file = PolicyFile.read(self._work.policy_path(), own=True)
        with contextlib.closing(self._queue(file)) as queue:
            queue.read_inbox()
            waiting = [each for each in queue.pending() if not each.is_allowed]
        groups = groupby(waiting, key=lambda each: each.stored.request.id)
        return bounded("questions", [_question(file, [*group]) for _, group in groups])

    def consider(self, question: bytes, coarse: str, seconds: int) -> Value:
        """What would be granted, through the filter `coarse`, for at most `seconds`.

        Raises:
            StoreError: it was answered.
            ConfigurationError, PolicyRefused: such a filter cannot be put on it.
        """
        if not 0 <= seconds <= MAX_SECONDS:
            raise KeyServiceRefused(f"{seconds} s is no time for a grant", "0: as asked")
        file = PolicyFile.read(self._work.policy_path(), own=True)
        change = changed_by(file, coarse, seconds, self._work.now())
        with contextlib.closing(self._queue(file)) as queue:
            found = pending_of(queue, question)
        return to_value(tuple(_right(file, change(approve(each.verdict))) for each in found))

    def _queue(self, file: PolicyFile) -> ApprovalQueue:
        return ApprovalQueue(self._work.home(), file, self._work.now())


def pending_of(queue: ApprovalQueue, question: bytes) -> list[PendingApproval]:
    """The rights of one question that wait for a person.

    Raises:
        StoreError: none does.
    """
    found = [
        each
        for each in queue.pending()
        if each.stored.request.id == question and not each.is_allowed
    ]
    if not found:
        raise StoreError("this question was answered", "look at what happened to it")
    return found


def changed_by(file: PolicyFile, coarse: str, seconds: int, now: int) -> VerdictChange:
    """As `verdict_change`, for at most `seconds` with all renewals; 0: as asked."""
    change = verdict_change(file, coarse or None, now, only_today=False)

    def restrict(verdict: Verdict) -> Verdict:
        changed = change(verdict)
        return limit(changed, seconds) if seconds else changed

    return restrict


def _question(file: PolicyFile, waiting: list[PendingApproval]) -> GrantQuestion:
    stored, verdicts = waiting[0].stored, [approve(each.verdict) for each in waiting]
    return GrantQuestion(
        stored.request.id,
        stored.request.node,
        verdicts[0].subject.key,
        stored.request.why,
        stored.at,
        stored.at + file.policy.defaults.prompt_timeout,
        min(max(verdict.lifetime, verdict.renew_until) for verdict in verdicts),
        tuple(_filters(file, verdicts)),
        tuple(_right(file, verdict) for verdict in verdicts),
    )


def _filters(file: PolicyFile, verdicts: list[Verdict]) -> list[str]:
    """The filters that fit all of the rights, those of the policy first."""
    if any(verdict.right is not Right.SUBSCRIBE for verdict in verdicts):
        return []
    names = dict.fromkeys((*file.policy.filters, *PRESETS))
    return [name for name in names if _fits(file, name, verdicts)]


def _fits(file: PolicyFile, name: str, verdicts: list[Verdict]) -> bool:
    change = verdict_change(file, name, 0, only_today=False)
    try:
        for verdict in verdicts:
            permissions(change(verdict))
    except HintedError:
        return False
    return True


def _right(file: PolicyFile, verdict: Verdict) -> AskedRight:
    return AskedRight(
        int(verdict.right),
        verdict.name,
        file.policy.type_of(verdict.name) or "",
        rule_ids(verdict.rules),
        next((rule.why for rule in verdict.rules if rule.why), ""),
        scope_of(permissions(verdict)),
    )
