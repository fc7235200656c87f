"""What nodes ask for, as the policy would grant it: the questions a person answers.

The policy decides first: what it denies is denied, what it allows waits only for the key and is no
question. Looking denies what nobody answered in time, as `rossec grant pending` does. Each right is
a question of its own: who may see a camera may not drive for that.
"""

import contextlib
import hashlib
from collections.abc import Callable, Mapping
from typing import Final

from ca.encoding import Value, encode
from ca.errors import HintedError, StoreError
from grants.claims import scope_of
from grants.filters.presets import PRESETS
from grants.model import ID_SIZE, Right
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
from rossec.authority.console.views import AskedRight, GrantQuestion, QuestionAnswer
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.policyfile import PolicyFile
from rossec.authority.requests import GrantRequestStore, StoredRequest
from rossec.errors import KeyServiceRefused

MAX_SECONDS: Final = 10 * 366 * 86400
_PART: Final = "rossec-question-part"


class Questions:
    """The operations about what nodes ask for."""

    def __init__(self, work: AuthorityWork) -> None:
        self._work = work

    def handlers(self) -> Mapping[str, Callable[..., Value]]:
        """By the operation."""
        return {
            "questions": self.questions,
            "consider": self.consider,
            "question-answers": self.answers,
        }

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
        return bounded("questions", [_question(file, each) for each in waiting], by_node)

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

    def answers(self, question: bytes) -> Value:
        """How a question was answered; nothing: it waits, or there is none."""
        with contextlib.closing(self._work.home().store()) as store:
            found = GrantRequestStore(store.database).answers()
        return to_value(
            tuple(
                QuestionAnswer(
                    each.stored.request.node, int(each.stored.requested.right),
                    each.stored.requested.pattern, each.answer, each.reason, each.at,
                )
                for each in found
                if is_about(each.stored, question)
            )
        )  # fmt: skip

    def _queue(self, file: PolicyFile) -> ApprovalQueue:
        return ApprovalQueue(self._work.home(), file, self._work.now())


def by_node(question: GrantQuestion) -> str:
    """Whose question it is: none pushes another node's out of the list."""
    return question.node


def question_id(stored: StoredRequest) -> bytes:
    """The id of the question for one right: of a request for no other, the request's own."""
    request, asked = stored.request, stored.requested
    if len(request.rights) == 1:
        return request.id
    part = encode([_PART, request.id, int(asked.right), asked.pattern])
    return hashlib.sha256(part).digest()[:ID_SIZE]


def is_about(stored: StoredRequest, question: bytes) -> bool:
    """Whether a right is the one of this question, or of this whole request."""
    return question in (stored.request.id, question_id(stored))


def pending_of(queue: ApprovalQueue, question: bytes) -> list[PendingApproval]:
    """The rights of one question, or of a whole request, that wait for a person.

    Raises:
        StoreError: none does.
    """
    found = [
        each for each in queue.pending() if is_about(each.stored, question) and not each.is_allowed
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


def longest(verdict: Verdict) -> int:
    """The seconds that the policy gives, renewals by the master included."""
    return max(verdict.lifetime, verdict.renew_until)


def _question(file: PolicyFile, waiting: PendingApproval) -> GrantQuestion:
    stored, verdict = waiting.stored, approve(waiting.verdict)
    return GrantQuestion(
        question_id(stored),
        stored.request.node,
        verdict.subject.key,
        stored.request.why,
        stored.at,
        stored.at + file.policy.defaults.prompt_timeout,
        longest(verdict),
        tuple(_filters(file, verdict)),
        (_right(file, verdict),),
        stored.request.id,
    )


def _filters(file: PolicyFile, verdict: Verdict) -> list[str]:
    """The filters that fit the right, those of the policy first."""
    if verdict.right is not Right.SUBSCRIBE:
        return []
    names = dict.fromkeys((*file.policy.filters, *PRESETS))
    return [name for name in names if _fits(file, name, verdict)]


def _fits(file: PolicyFile, name: str, verdict: Verdict) -> bool:
    change = verdict_change(file, name, 0, only_today=False)
    try:
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
