"""The approval queue: grant requests are decided by the policy, or by a person.

Only `sign` needs the authority's key. A request that nobody answers in time is not shown any more,
and denied for good only when its node has sent many after it: a clock may be ahead for one look.
"""

import contextlib
import secrets
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec

from ca.errors import HintedError, RecordUnusable, StoreError
from grants.filters.compile import PRESETS, compile_filter, preset
from grants.model import Draft, Restriction
from grants.policy.decision import Verdict
from grants.policy.model import Effect, Policy, Subject
from grants.policy.wanted import approve, approximate, drafts, rule_ids, shorten
from grants.request import GrantRequest, open_request, peek_request
from rossec.authority import requests
from rossec.authority.home import AuthorityHome
from rossec.authority.policyfile import PolicyFile, layout_of
from rossec.authority.requests import GrantRequestStore, StoredRequest
from rossec.authority.signing import OF_ALL, SKEW, SignedGrants, SigningAuthority
from rossec.clock import seconds_left_today
from rossec.errors import ConfigurationError

MAX_PENDING: Final = 16  # prompts that one node may have pending
MAX_LATE: Final = 64  # of one node that are kept although nobody answered in time
GRANTED, DENIED, LATE, TOO_MANY = "granted", "denied", "no answer", "too many"

_NO_RULE: Final = "no rule gives it, and where none does the policy denies (defaults: decision)"

VerdictChange = Callable[[Verdict], Verdict]


@dataclass(frozen=True)
class PendingGrantRequest:
    """A requested right that waits for a person, or only for the key: see `verdict`."""

    stored: StoredRequest
    verdict: Verdict

    @property
    def is_allowed(self) -> bool:
        """Whether the policy allows it, so that it waits only for the key."""
        return self.verdict.effect is Effect.ALLOW


class Denial(NamedTuple):
    stored: StoredRequest
    reason: str


class GrantRequestQueue:
    """`denied` are those that the last call of `pending` left out, each with the reason."""

    def __init__(self, home: AuthorityHome, policy: PolicyFile, now: int) -> None:
        self._home = home
        self._policy = policy
        self._decider = policy.decider
        self._now = now
        self._store = home.store()
        self._requests = GrantRequestStore(self._store.database)
        self.denied = list[Denial]()

    def close(self) -> None:
        self._store.close()

    def add_request(self, data: bytes) -> GrantRequest:
        named = peek_request(data).node
        row = self._store.valid_certificate(named, self._now)
        key = x509.load_der_x509_certificate(row.der).public_key()
        assert isinstance(key, ec.EllipticCurvePublicKey)  # noqa: S101 - we signed it
        request = open_request(data, key, domain=self._home.domain, now=self._now)
        self._requests.add(request, data, self._now)
        return request

    def read_inbox(self) -> list[str]:
        """Record the requests in the inbox directory; returns one line for each invalid one."""
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

    def pending(self) -> list[PendingGrantRequest]:
        with self._store.transaction():
            return self._decided()

    def _decided(self) -> list[PendingGrantRequest]:
        approvals: list[PendingGrantRequest] = []
        self.denied = []
        waiting = Counter[str]()
        unanswered = self._requests.unanswered()
        counts = Counter(stored.request.node for stored in unanswered)
        for stored in unanswered:
            try:
                verdict = self._verdict(stored)
            except HintedError as error:
                # Its identity may only have expired, by a clock that is ahead.
                had_identity = bool(self._store.identities.valid(stored.request.node, stored.at))
                if not had_identity or self._is_for_good(stored, counts):
                    self._requests.answer(stored, DENIED, str(error), self._now)
                self.denied.append(Denial(stored, str(error)))
                continue
            if verdict.effect is Effect.DENY:
                rule = verdict.rules[0] if verdict.rules else None
                self._requests.answer(stored, DENIED, f"rule {rule.id}" if rule else "by default", self._now)
                self.denied.append(Denial(stored, f"by {rule.reason}" if rule else _NO_RULE))
                continue
            why, node = "", stored.request.node
            if verdict.effect is Effect.PROMPT:
                if self._now > stored.at + self._decider.policy.defaults.prompt_timeout:
                    why = LATE
                else:
                    waiting[node] += 1
                    why = TOO_MANY if waiting[node] > MAX_PENDING else ""
            if why:
                if why != LATE or self._is_for_good(stored, counts):
                    self._requests.answer(stored, DENIED, why, self._now)
                self.denied.append(Denial(stored, why))
                continue
            approvals.append(PendingGrantRequest(stored, verdict))
        return approvals

    def chosen(self, beginning: str) -> list[PendingGrantRequest]:
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

    def deny(self, approval: PendingGrantRequest, reason: str) -> None:
        self._requests.answer(approval.stored, DENIED, reason, self._now)

    def sign(
        self,
        authority: SigningAuthority,
        approvals: Iterable[PendingGrantRequest],
        change: VerdictChange,
        reason: str,
    ) -> SignedGrants:
        """Sign the verdicts, modified by `change`; returns the grants with their drafts."""
        chosen = list(approvals)
        made = self.drafts(authority.domain, chosen, change)
        answers = GrantRequestStore(authority.store.database)
        # Two people may use the queue at once: an answer is recorded with the grants it gives, or not at all.
        with authority.store.transaction():
            self._policy.check_unchanged()
            for approval in chosen:
                answers.answer(approval.stored, GRANTED, reason, self._now)
            signed = authority.issue_grants(made, self._now)
        return [(draft, data) for (draft, _), data in zip(made, signed, strict=True)]

    def sign_each(
        self, authority: SigningAuthority, approvals: Iterable[PendingGrantRequest], reason: str
    ) -> tuple[SignedGrants, list[Denial]]:
        """Sign what the policy allows; what cannot be in a grant is denied alone, and returned."""
        # All together if that is possible, else each request alone, and of one each right.
        chosen = list(approvals)
        try:
            return self.sign(authority, chosen, lambda verdict: verdict, reason), []
        except OF_ALL:
            raise
        except HintedError as error:
            self._policy.check_unchanged()
            if len(chosen) == 1:
                denial = Denial(chosen[0].stored, f"it cannot be granted: {error}")
                with contextlib.suppress(StoreError):  # it may have been answered meanwhile
                    self.deny(chosen[0], denial.reason)
                return [], [denial]
        signed, refused = SignedGrants(), list[Denial]()
        for part in _parts(chosen):
            found, left = self.sign_each(authority, part, reason)
            signed += found
            refused += left
        return signed, refused

    def drafts(
        self, domain: str, approvals: Iterable[PendingGrantRequest], change: VerdictChange
    ) -> list[tuple[Draft, str]]:
        """The grants to sign for the verdicts, modified by `change`."""
        # With the rules of those that the policy allows by itself.
        groups: dict[str, list[Verdict]] = {}
        for approval in approvals:
            verdict = change(approve(approval.verdict))
            rules = rule_ids(verdict.rules) if approval.is_allowed else ""
            groups.setdefault(rules, []).append(verdict)
        return [
            (draft, rules)
            for rules, group in groups.items()
            for draft in drafts(
                group, domain=domain, now=self._now, skew=SKEW, serial=lambda: secrets.token_bytes(16)
            )
        ]

    def _verdict(self, stored: StoredRequest) -> Verdict:
        row = self._store.valid_certificate(stored.request.node, self._now)
        subject = Subject(row.name, row.thumbprint, row.wildcard)
        return self._decider.decide(subject, stored.requested.right, stored.requested.pattern)

    def _is_for_good(self, stored: StoredRequest, counts: Counter[str]) -> bool:
        # Whether to record what only the clock says; else it comes back when that is set right.
        # `counts`: what has no answer yet, by node; oldest first, so the newest stay.
        counts[stored.request.node] -= 1
        return counts[stored.request.node] >= MAX_LATE


def _parts(approvals: list[PendingGrantRequest]) -> list[list[PendingGrantRequest]]:
    by_request: dict[bytes, list[PendingGrantRequest]] = {}
    for item in approvals:
        by_request.setdefault(item.stored.request.id, []).append(item)
    return [*by_request.values()] if len(by_request) > 1 else [[item] for item in approvals]


def verdict_change(file: PolicyFile, coarse: str | None, now: int, *, only_today: bool) -> VerdictChange:
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
    kind = policy.type_of(topic)
    if kind is None:
        raise ConfigurationError(f"the type of {topic} is not known here", "add it to types")
    layout = layout_of(kind)
    if name not in policy.filters:
        return preset(name).restriction(layout)
    compile_filter(layout, policy.filters[name])
    return Restriction(kind, (), tuple(sorted(policy.filters[name])))
