"""What nodes ask for, as a person answers it: questions, approved grants, and taking away.

The policy decides first: what it denies is denied, what it allows waits only for the key and is no
question. Taking away needs no passkey: denying is never harder. What was approved and still waits for
the key comes to nothing as soon as what it is about is denied or ended.
"""

import contextlib
import hashlib
from collections.abc import Callable
from contextlib import closing
from hashlib import sha256
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

from ca.approvals.statement import MAX_PAYLOAD, GrantStatement, StatementKind
from ca.encoding import Value, decode, encode
from ca.errors import HintedError, StoreError
from ca.keys.signing import thumbprint
from ca.names import check_name, is_master_name
from ca.store import log, values
from ca.store.record import Store
from grants import document
from grants.filters.compile import PRESETS
from grants.model import ID_SIZE, Draft, Right
from grants.policy.decision import Verdict
from grants.policy.wanted import approve, limit, permissions, rule_ids
from rossec.authority import grant_queue, invitations, signing
from rossec.authority.console.approving import Approved, ApprovedAct, Wanted
from rossec.authority.console.messages import AskedRight, GrantQuestion, QuestionAnswer, given, to_value
from rossec.authority.console.queries import bounded
from rossec.authority.invitations import InvitationStatus
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.policyfile import PolicyFile
from rossec.authority.requests import GrantRequestStore, StoredRequest
from rossec.authority.service import AuthorityService
from rossec.authority.signing import OWN_NODE
from rossec.clock import format_duration
from rossec.errors import AuthorityLocked, ConfigurationError, KeyServiceRefused

MAX_SECONDS: Final = 10 * 366 * 86400
_PART: Final = "rossec-question-part"
_ANSWERED: Final = "this question was answered", "look at what happened to it"
_T = TypeVar("_T")


class Questions:
    def __init__(self, work: AuthorityWork) -> None:
        self._work = work

    def questions(self) -> Value:
        if not self._work.policy_path().exists():
            return []
        file = PolicyFile.read(self._work.policy_path(), own=True)
        with contextlib.closing(self._queue(file)) as queue:
            queue.read_inbox()
            waiting = [each for each in queue.pending() if not each.is_allowed]
        views, timeout = [], file.policy.defaults.prompt_timeout
        for each in waiting:
            stored, verdict = each.stored, approve(each.verdict)
            number, key, asked = question_id(stored), verdict.subject.key, stored.request
            times = stored.at, stored.at + timeout, longest(verdict)
            offered, rights = tuple(_filters(file, verdict)), (_right(file, verdict),)
            views.append(GrantQuestion(number, asked.node, key, asked.why, *times, offered, rights, asked.id))
        # By node: none pushes another node's questions out of the list.
        return bounded("questions", views, lambda view: view.node)

    def consider(self, question: bytes, coarse: str, seconds: int) -> Value:
        # What would be granted, through the filter `coarse`, for at most `seconds`.
        if not 0 <= seconds <= MAX_SECONDS:
            raise KeyServiceRefused(f"{seconds} s is no time for a grant", "0: as asked")
        file = PolicyFile.read(self._work.policy_path(), own=True)
        change = changed_by(file, coarse, seconds, self._work.now())
        with contextlib.closing(self._queue(file)) as queue:
            found = pending_of(queue, question)
        return to_value(tuple(_right(file, change(approve(each.verdict))) for each in found))

    def question_answers(self, question: bytes) -> Value:
        with self._work.record() as store:
            found = GrantRequestStore(store.database).answers()
        views = []
        for stored, answer, reason, at in found:
            if is_about(stored, question):
                node, asked = stored.request.node, stored.requested
                views.append(QuestionAnswer(node, int(asked.right), asked.pattern, answer, reason, at))
        return to_value(tuple(views))

    def _queue(self, file: PolicyFile) -> grant_queue.GrantRequestQueue:
        return grant_queue.GrantRequestQueue(self._work.home(), file, self._work.now())


def question_id(stored: StoredRequest) -> bytes:
    # Each right is a question of its own: who may see a camera may not drive for that.
    request, asked = stored.request, stored.requested
    if len(request.rights) == 1:
        return request.id
    part = encode([_PART, request.id, int(asked.right), asked.pattern])
    return hashlib.sha256(part).digest()[:ID_SIZE]


def is_about(stored: StoredRequest, question: bytes) -> bool:
    return question in (stored.request.id, question_id(stored))


def pending_of(
    queue: grant_queue.GrantRequestQueue, question: bytes
) -> list[grant_queue.PendingGrantRequest]:
    found = [each for each in queue.pending() if is_about(each.stored, question) and not each.is_allowed]
    if not found:
        raise StoreError(*_ANSWERED)
    return found


def changed_by(file: PolicyFile, coarse: str, seconds: int, now: int) -> grant_queue.VerdictChange:
    """As `verdict_change`, for at most `seconds` with all renewals; 0: as asked."""
    change = grant_queue.verdict_change(file, coarse or None, now, only_today=False)

    def restrict(verdict: Verdict) -> Verdict:
        changed = change(verdict)
        return limit(changed, seconds) if seconds else changed

    return restrict


def longest(verdict: Verdict) -> int:
    return max(verdict.lifetime, verdict.renew_until)


def _filters(file: PolicyFile, verdict: Verdict) -> list[str]:
    if verdict.right is not Right.SUBSCRIBE:
        return []
    found = []
    for name in dict.fromkeys((*file.policy.filters, *PRESETS)):
        with contextlib.suppress(HintedError):  # it does not fit messages of this type
            permissions(grant_queue.verdict_change(file, name, 0, only_today=False)(verdict))
            found.append(name)
    return found


def _right(file: PolicyFile, verdict: Verdict) -> AskedRight:
    return AskedRight(
        int(verdict.right),
        verdict.name,
        file.policy.type_of(verdict.name) or "",
        rule_ids(verdict.rules),
        next((rule.why for rule in verdict.rules if rule.why), ""),
        document.scope_of(permissions(verdict)),
    )


_MALFORMED: Final = "the payload of an approval is malformed", "restore a backup"


class GrantAnswer(NamedTuple):
    # The payload: the digest of the policy file, the rights that are answered, each grant's claims and rules.

    policy: bytes
    rights: tuple[tuple[int, str], ...]
    grants: tuple[tuple[bytes, str], ...]

    def to_bytes(self) -> bytes:
        rights: list[Value] = [[*each] for each in self.rights]
        grants: list[Value] = [[*each] for each in self.grants]
        return encode([self.policy, rights, grants])

    @classmethod
    def from_bytes(cls, data: bytes) -> "GrantAnswer":
        match decode(data, limit=MAX_PAYLOAD):
            case [bytes(policy), [*rights], [*grants]]:
                found = tuple(_pair(bytes, each) for each in grants)
                return cls(policy, tuple(_pair(int, each) for each in rights), found)
            case _:
                raise ConfigurationError(*_MALFORMED)

    def drafts(self) -> list[tuple[Draft, str]]:
        return [(_draft(body), rules) for body, rules in self.grants]


class GrantAct(ApprovedAct):
    """Grants for a question: its id, a coarser filter, at most so many seconds (0: as asked)."""

    kind = StatementKind.GRANT

    def __init__(self, policy: Path) -> None:
        self._policy = policy

    def prepare(
        self, service: AuthorityService, now: int, question: bytes, coarse: str, seconds: int
    ) -> Wanted:
        if seconds < 0:
            raise KeyServiceRefused("these are not the arguments of a grant", "")
        if service.home.is_intermediate:
            raise KeyServiceRefused("an intermediate signs no grants", "do it at the root")
        file = PolicyFile.read(self._policy, own=True)
        change = changed_by(file, coarse, seconds, now)
        with closing(grant_queue.GrantRequestQueue(service.home, file, now)) as queue:
            found = pending_of(queue, question)
            most = min(longest(each.verdict) for each in found)
            if seconds > most:  # what was approved is what is signed: it is not made shorter without a word
                allowed = f"the policy allows this for {format_duration(most)} at most"
                raise KeyServiceRefused(allowed, "choose a shorter time")
            made = queue.drafts(service.home.domain, found, change)
        issuer = thumbprint(service.home.own_key())
        # The grants are made now, and signed as they are shown, times and serials included.
        answer = GrantAnswer(
            sha256(file.text.encode()).digest(),
            tuple((int(each.stored.requested.right), each.stored.requested.pattern) for each in found),
            tuple((encode(document.from_draft(draft, issuer)), rules) for draft, rules in made),
        )
        payload = answer.to_bytes()
        return GrantStatement(question, sha256(payload).digest()), payload

    def admit(self, store: Store, approved: Approved) -> str | None:
        answer = GrantAnswer.from_bytes(approved.payload)
        self._check_policy(answer)
        table, question = GrantRequestStore(store.database), approved.approval.subject
        found = {
            (int(each.requested.right), each.requested.pattern): each
            for each in table.unanswered()
            if is_about(each, question)
        }
        for right in answer.rights:
            if right not in found:
                raise StoreError(*_ANSWERED)
            table.answer(found[right], grant_queue.GRANTED, approved.reason, approved.at)
        return None

    def carry_out(self, service: AuthorityService, approved: Approved, now: int) -> None:
        answer, authority = GrantAnswer.from_bytes(approved.payload), service.unlock()
        drafts, issuer = answer.drafts(), thumbprint(authority.signer.public_key)
        for (draft, _), (body, _) in zip(drafts, answer.grants, strict=True):
            if encode(document.from_draft(draft, issuer)) != body or now >= draft.expires:
                raise StoreError("the grants are over, or not for this authority", "ask again")

        def check() -> None:
            self._check_policy(answer)
            for draft, _ in drafts:
                held = authority.store.valid_certificate(draft.subject, now)
                if held.thumbprint != draft.holder:
                    raise StoreError(f"{draft.subject} has another key now", "it has to ask again")
            approved.conclude(authority.store, given([body for body, _ in answer.grants]), now)

        for data in authority.issue_grants(drafts, now, check):
            service.grants.store(data)

    def made(self, _service: AuthorityService, approved: Approved) -> bytes:
        bodies: list[Value] = [body for body, _ in GrantAnswer.from_bytes(approved.payload).grants]
        return encode(bodies)

    def _check_policy(self, answer: GrantAnswer) -> None:
        file = PolicyFile.read(self._policy, own=True)
        if sha256(file.text.encode()).digest() != answer.policy:
            raise ConfigurationError("the policy was changed meanwhile", "look at it again")


def _pair(kind: type[_T], value: Value) -> tuple[_T, str]:
    match value:
        case [first, str(text)] if isinstance(first, kind):
            return first, text
        case _:
            raise ConfigurationError(*_MALFORMED)


def _draft(body: bytes) -> Draft:
    found = document.read_claims(body, bytes(ID_SIZE))
    about = found.domain, found.subject, found.holder, found.not_before, found.expires, found.cap
    return Draft(*about, found.serial, found.permissions)


PURPOSE: Final = "a revocation at the console"
MAX_REASON: Final = 256  # characters
UNSIGNED: Final = (0, 0)  # the number of a list that is signed when the key is unlocked

Find = Callable[[Store, int], frozenset[bytes]]


class Removals:
    """`wake`: begins a round of the service, which tells the master."""

    def __init__(self, work: AuthorityWork, wake: Callable[[], None]) -> None:
        self._work = work
        self._wake = wake

    def deny_request(self, digest: bytes, reason: str) -> Value:
        # Deny a request for an identity, also one that was approved and is not issued yet.
        why, at = checked_reason(reason), self._work.now()
        with self._work.record() as store, store.transaction():
            if store.requests.find(digest) is None:
                raise StoreError("there is no such request", "it may have expired")
            store.requests.deny(digest, at, why)
            _end_about(store, StatementKind.ENROLL, digest, why, at)
        return None

    def deny_question(self, request: bytes, reason: str) -> Value:
        # Deny a right, or a whole request, also if it was approved and is not signed yet.
        why, at = checked_reason(reason), self._work.now()
        with self._work.record() as store, store.transaction():
            table = GrantRequestStore(store.database)
            found = [each for each in table.unanswered() if is_about(each, request)]
            for each in found:
                table.answer(each, grant_queue.DENIED, why or "a person", at)
            parts = {request, *map(question_id, table.find(request))}
            ended = [_end_about(store, StatementKind.GRANT, part, why, at) for part in sorted(parts)]
            if not found and not any(ended):
                raise StoreError(*_ANSWERED)
        return None

    def revoke_grant(self, grant: bytes, reason: str) -> Value:
        def find(store: Store, _: int) -> frozenset[bytes]:
            if all(row.id != grant for row in store.grants()):
                raise StoreError("there is no such grant", "look again: the record was changed")
            return frozenset((grant,))

        return self._revoke(find, reason)

    def revoke_node(self, name: str, reason: str) -> Value:
        if name == OWN_NODE:
            raise KeyServiceRefused(
                f"{name} is the authority's own node, which tells the master what is revoked",
                "if the authority was stolen, make a new one",
            )
        if is_master_name(name):  # nothing works without one, so a stolen session must not end it
            raise KeyServiceRefused(
                f"without {name} its nodes find nothing: a phone has to approve that", "approve it there"
            )
        return self._revoke(keys_of(name), reason)

    def end_invitation(self, invitation: bytes, reason: str) -> Value:
        # End a join code; what waits because of it is denied.
        why, at = checked_reason(reason), self._work.now()
        with self._work.record() as store, store.transaction():
            table = store.invitations
            status = InvitationStatus(table.get(invitation), table.uses(invitation), table.ended(invitation))
            before = {row.digest for row in store.requests.open(at)}
            invitations.end(store, status, why, at)
            for digest in sorted(before - {row.digest for row in store.requests.open(at)}):
                _end_about(store, StatementKind.ENROLL, digest, f"its join code was ended: {why}", at)
        return None

    def remove_phone(self, passkey: bytes, reason: str) -> Value:
        # End a passkey, and what it approved and is not carried out yet.
        with self._work.record() as store:
            store.remove_passkey(passkey, checked_reason(reason), self._work.now())
        return None

    def _revoke(self, find: Find, reason: str) -> Value:
        # Recorded at once, with its list unless the key is locked: then it is signed when that is unlocked.
        why, at, number = checked_reason(reason), self._work.now(), UNSIGNED
        with self._work.service(PURPOSE) as service:
            if service.home.is_intermediate:
                raise ConfigurationError("an intermediate cannot revoke", "do it at the root")
            try:
                authority = service.unlock()
                with authority.store.transaction():
                    number = authority.revoke_all(find(authority.store, at), why, at).number
            except AuthorityLocked:
                with contextlib.closing(service.home.store()) as store, store.transaction():
                    for entry in sorted(find(store, at)):
                        store.revoke(entry, why, at)
        self._wake()
        return [*number]


def checked_reason(text: str) -> str:
    if len(text) > MAX_REASON:
        raise KeyServiceRefused(
            f"a reason of {len(text)} characters where {MAX_REASON} are allowed", "write less"
        )
    return text.strip()


def keys_of(name: str) -> Find:
    """Finds the keys of `name`, and the things that end with them; none is a refusal."""

    def find(store: Store, at: int) -> frozenset[bytes]:
        sought = name if name.startswith(values.INTERMEDIATE) else check_name(name)
        found = store.unrevoked_keys(sought, at)
        if not found:
            raise ConfigurationError(
                f"{name} has no valid identity to revoke", "it may have been revoked already"
            )
        return found | signing.ended_with(store, sought, at)

    return find


def _end_about(store: Store, kind: StatementKind, subject: bytes, reason: str, at: int) -> bool:
    waiting = [
        approval
        for approval in store.approvals.about(kind, subject)
        if store.approvals.state(approval.id) is log.ApprovalState.WAITING
    ]
    for approval in waiting:
        result = f"denied: {reason}" if reason else "denied"
        store.approvals.end(approval.id, log.ApprovalState.FAILED, result, at)
    return bool(waiting)
