"""Where requests are decided: by the policy, or by a person where the policy wants one stored.

A shell around the authority, its policy and its inbox. Only `sign` needs the key. A person who
does not answer in time has said no; so does the desk when a node asks for too much at once. Two
people may sit at it: an answer is recorded together with the grants it gives, or not at all.
"""

import secrets
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec

from ca.errors import HintedError, RecordUnusable
from grants.model import Draft
from grants.policy.decision import Verdict
from grants.policy.drafts import approve, drafts
from grants.policy.model import Effect, Subject
from grants.request import GrantRequest, open_request, peek_request
from rossec.authority import requests
from rossec.authority.home import AuthorityHome
from rossec.authority.policyfile import PolicyFile
from rossec.authority.requests import GrantRequestStore, StoredRequest
from rossec.authority.signing import SigningAuthority

MAX_PENDING: Final = 16  # prompts one node may have waiting
GRANTED, DENIED, LATE, TOO_MANY = "granted", "denied", "no answer", "too many"

VerdictChange = Callable[[Verdict], Verdict]


@dataclass(frozen=True)
class PendingApproval:
    """A wish that waits for a person, or only for the key: see `verdict`."""

    stored: StoredRequest
    verdict: Verdict


class ApprovalQueue:
    """The authority's desk at `now`, deciding by `policy`.

    `denied` counts what the last `approvals` answered with a no by itself.
    """

    def __init__(self, home: AuthorityHome, policy: PolicyFile, now: int) -> None:
        self._home = home
        self._policy = policy
        self._decider = policy.decider
        self._now = now
        self._store = home.store()
        self._requests = GrantRequestStore(self._store.database)
        self.denied_automatically = 0

    def close(self) -> None:
        """Close the record."""
        self._store.close()

    def add_request(self, data: bytes) -> GrantRequest:
        """Record one request, verified with the key its node was enrolled with.

        Raises:
            HintedError: not a request of an enrolled node, or known already.
        """
        named = peek_request(data).node
        row = self._store.valid_certificate(named, self._now)
        key = x509.load_der_x509_certificate(row.der).public_key()
        assert isinstance(key, ec.EllipticCurvePublicKey)  # noqa: S101 - we signed it
        request = open_request(data, key, domain=self._home.domain, now=self._now)
        self._requests.add(request, data, self._now)
        return request

    def read_inbox(self) -> list[str]:
        """Take what lies in the inbox directory; returns what was wrong, a line each.

        Raises:
            RecordUnusable: what could not be recorded stays in the inbox.
        """
        trouble: list[str] = []
        with self._store.transaction():  # another desk takes what this one has not
            paths = requests.inbox_files(self._home.path)
            for path in paths:
                try:
                    self.add_request(requests.read_request(path))
                except RecordUnusable:
                    raise
                except HintedError as error:
                    trouble.append(f"{path.name}: {error}")
        for path in paths:
            path.unlink(missing_ok=True)
        return trouble

    def pending(self) -> list[PendingApproval]:
        """What is not answered; what the policy denies, or nobody answered, is answered here."""
        with self._store.transaction():
            return self._pending()

    def _pending(self) -> list[PendingApproval]:
        approvals: list[PendingApproval] = []
        waiting: dict[str, int] = {}
        unanswered = self._requests.unanswered()
        for stored in unanswered:
            try:
                verdict = self._verdict(stored)
            except HintedError as error:  # its identity has expired since
                self._requests.answer(stored, DENIED, str(error), self._now)
                continue
            if verdict.effect is Effect.DENY:
                self._requests.answer(stored, DENIED, _denial_reason(verdict), self._now)
                continue
            if verdict.effect is Effect.PROMPT and (why := self._automatic_denial(stored, waiting)):
                self._requests.answer(stored, DENIED, why, self._now)
                continue
            approvals.append(PendingApproval(stored, verdict))
        self.denied_automatically = len(unanswered) - len(approvals)
        return approvals

    def deny(self, approval: PendingApproval, reason: str) -> None:
        """A person said no."""
        self._requests.answer(approval.stored, DENIED, reason, self._now)

    def sign(
        self,
        authority: SigningAuthority,
        approvals: Iterable[PendingApproval],
        change: VerdictChange,
        reason: str,
    ) -> list[tuple[Draft, bytes]]:
        """Sign what was decided, as `change` makes it; returns the grants with what they say.

        Raises:
            PolicyRefused: one of them is denied, or cannot be expressed; nothing is signed then.
            StoreError: one was answered meanwhile, or its key revoked; nothing is signed then.
            ConfigurationError: the policy is another one by now; nothing is signed then.
        """
        chosen = list(approvals)
        verdicts = [change(approve(approval.verdict)) for approval in chosen]
        made = drafts(
            verdicts,
            domain=authority.domain,
            now=self._now,
            serial=lambda: secrets.token_bytes(16),
        )
        answers = GrantRequestStore(authority.store.database)
        with authority.store.transaction():
            self._policy.check_unchanged()
            for approval in chosen:
                answers.answer(approval.stored, GRANTED, reason, self._now)
            return [(draft, authority.issue_grant(draft, self._now)) for draft in made]

    def _verdict(self, stored: StoredRequest) -> Verdict:
        row = self._store.valid_certificate(stored.request.node, self._now)
        subject = Subject(row.name, row.thumbprint)
        return self._decider.decide(subject, stored.requested.right, stored.requested.pattern)

    def _automatic_denial(self, stored: StoredRequest, waiting: dict[str, int]) -> str:
        if self._now > stored.at + self._decider.policy.defaults.prompt_timeout:
            return LATE
        node = stored.request.node
        waiting[node] = waiting.get(node, 0) + 1
        return TOO_MANY if waiting[node] > MAX_PENDING else ""


def _denial_reason(verdict: Verdict) -> str:
    return f"rule {verdict.rules[0].id}" if verdict.rules else "by default"


def seconds_left_today(now: int) -> int:
    """Seconds left of this day, where this machine is."""
    local = time.localtime(now)
    return max(60, 86400 - (local.tm_hour * 3600 + local.tm_min * 60 + local.tm_sec))
