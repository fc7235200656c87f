"""The approval queue: grant requests are decided by the policy, or by a person.

Only `sign` needs the authority's key. A request that nobody answers in time is denied, as are those
of a node that has too many pending. Two people may use the queue at the same time: an answer is
recorded together with the grants it gives, or not at all.
"""

import secrets
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec

from ca.errors import HintedError, RecordUnusable
from grants.filters.compile import compile_filter
from grants.filters.presets import PRESETS, preset
from grants.model import Draft, Restriction
from grants.policy.decision import Verdict
from grants.policy.drafts import approve, approximate, drafts, shorten
from grants.policy.model import Effect, Policy, Subject
from grants.policy.wanted import rule_ids
from grants.request import GrantRequest, open_request, peek_request
from rossec.authority import requests
from rossec.authority.home import AuthorityHome
from rossec.authority.policyfile import PolicyFile, layout_of
from rossec.authority.requests import GrantRequestStore, StoredRequest
from rossec.authority.signing import SKEW, SigningAuthority
from rossec.clock import seconds_left_today
from rossec.errors import ConfigurationError

MAX_PENDING: Final = 16  # prompts that one node may have pending
GRANTED, DENIED, LATE, TOO_MANY = "granted", "denied", "no answer", "too many"

VerdictChange = Callable[[Verdict], Verdict]


@dataclass(frozen=True)
class PendingApproval:
    """A requested right that waits for a person, or only for the key: see `verdict`."""

    stored: StoredRequest
    verdict: Verdict

    @property
    def is_allowed(self) -> bool:
        """Whether the policy allows it, so that it waits only for the key."""
        return self.verdict.effect is Effect.ALLOW


class ApprovalQueue:
    """The pending grant requests at `now`, decided by `policy`.

    `denied_automatically` counts the denials of the last call of `pending`.
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
        """Record the requests in the inbox directory; returns one line for each invalid one.

        Raises:
            RecordUnusable: the requests stay in the inbox.
        """
        errors: list[str] = []
        with self._store.transaction():  # excludes other commands
            paths = requests.inbox_files(self._home.path)
            for path in paths:
                try:
                    self.add_request(requests.read_request(path))
                except RecordUnusable:
                    raise
                except HintedError as error:
                    errors.append(f"{path.name}: {error}")
        for path in paths:
            path.unlink(missing_ok=True)
        return errors

    def pending(self) -> list[PendingApproval]:
        """The unanswered requests; those denied by the policy or too late are denied here."""
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

    def chosen(self, beginning: str) -> list[PendingApproval]:
        """The rights that wait for a person, of the one request whose id begins so.

        Raises:
            ConfigurationError: there is none, or more than one.
        """
        found = [
            item
            for item in self.pending()
            if not item.is_allowed and item.stored.request.id.hex().startswith(beginning.lower())
        ]
        if len({item.stored.request.id for item in found}) != 1 or not beginning:
            count = "several requests begin" if found else "no open request begins"
            hint = "see: rossec grant pending; without an answer in time it was denied"
            raise ConfigurationError(f"{count} with {beginning!r}", hint)
        return found

    def deny(self, approval: PendingApproval, reason: str) -> None:
        """Record that a person denied the request."""
        self._requests.answer(approval.stored, DENIED, reason, self._now)

    def sign(
        self,
        authority: SigningAuthority,
        approvals: Iterable[PendingApproval],
        change: VerdictChange,
        reason: str,
    ) -> list[tuple[Draft, bytes]]:
        """Sign the verdicts, modified by `change`; returns the grants with their drafts.

        Raises:
            PolicyRefused: one is denied, or cannot be expressed as a grant; nothing is signed.
            StoreError: one was answered meanwhile, or its key revoked; nothing is signed.
            ConfigurationError: the policy was changed meanwhile; nothing is signed.
        """
        chosen = list(approvals)
        made = self.drafts(authority.domain, chosen, change)
        answers = GrantRequestStore(authority.store.database)
        with authority.store.transaction():
            self._policy.check_unchanged()
            for approval in chosen:
                answers.answer(approval.stored, GRANTED, reason, self._now)
            signed = authority.issue_grants(made, self._now)
        return [(draft, data) for (draft, _), data in zip(made, signed, strict=True)]

    def drafts(
        self, domain: str, approvals: Iterable[PendingApproval], change: VerdictChange
    ) -> list[tuple[Draft, str]]:
        """The grants to sign for the verdicts, modified by `change`.

        With the rules of those that the policy allows by itself.

        Raises:
            PolicyRefused: as `sign`.
        """
        groups: dict[str, list[Verdict]] = {}
        for approval in approvals:
            verdict = change(approve(approval.verdict))
            rules = rule_ids(verdict.rules) if approval.is_allowed else ""
            groups.setdefault(rules, []).append(verdict)
        return [
            (draft, rules)
            for rules, group in groups.items()
            for draft in drafts(
                group, domain=domain, now=self._now, skew=SKEW,
                serial=lambda: secrets.token_bytes(16),
            )
        ]  # fmt: skip

    def _verdict(self, stored: StoredRequest) -> Verdict:
        row = self._store.valid_certificate(stored.request.node, self._now)
        subject = Subject(row.name, row.thumbprint, row.wildcard)
        return self._decider.decide(subject, stored.requested.right, stored.requested.pattern)

    def _automatic_denial(self, stored: StoredRequest, waiting: dict[str, int]) -> str:
        if self._now > stored.at + self._decider.policy.defaults.prompt_timeout:
            return LATE
        node = stored.request.node
        waiting[node] = waiting.get(node, 0) + 1
        return TOO_MANY if waiting[node] > MAX_PENDING else ""


def verdict_change(
    file: PolicyFile, coarse: str | None, now: int, *, only_today: bool
) -> VerdictChange:
    """How a person restricts a verdict: through the filter `coarse`, until midnight.

    Raises:
        ConfigurationError: neither the policy nor a preset has the filter.
    """
    if coarse is not None and coarse not in {*file.policy.filters, *PRESETS}:
        known = ", ".join({**file.policy.filters, **PRESETS})
        raise ConfigurationError(f"no filter {coarse!r} in {file.path}", f"there are: {known}")
    left = seconds_left_today(now) if only_today else None

    def change(verdict: Verdict) -> Verdict:
        if coarse is not None:
            verdict = approximate(verdict, _restriction(file.policy, verdict.name, coarse))
        return verdict if left is None else shorten(verdict, left)

    return change


def _restriction(policy: Policy, topic: str, name: str) -> Restriction:
    """The filter `name` of the policy, or the preset of that name, for a topic."""
    kind = policy.type_of(topic)
    if kind is None:
        raise ConfigurationError(f"the type of {topic} is not known here", "add it to types")
    layout = layout_of(kind)
    if name not in policy.filters:
        return preset(name).restriction(layout)
    compile_filter(layout, policy.filters[name])
    return Restriction(kind, (), tuple(sorted(policy.filters[name])))


def _denial_reason(verdict: Verdict) -> str:
    return f"rule {verdict.rules[0].id}" if verdict.rules else "by default"
