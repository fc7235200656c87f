"""Approving what a node asks for: the grants are made when they are shown, and signed as shown.

The payload is the CBOR list `[policy, rights, grants]`: the digest of the policy file by which they
were made, the requested rights that are answered (`[right, pattern]`), and of each grant its claims
as they are signed and its rules. Times and serials are in the claims: a grant that waits for the
key does not last longer by that.
"""

from contextlib import closing
from hashlib import sha256
from pathlib import Path
from typing import Final, NamedTuple

from ca.approvals.statement import MAX_PAYLOAD, Grant
from ca.encoding import Value, decode, encode
from ca.errors import StoreError
from ca.keys.publickey import thumbprint
from ca.store.record import Store
from grants import claims
from grants.model import ID_SIZE, Draft
from rossec.authority.approvals import (
    GRANTED,
    ApprovalQueue,
)
from rossec.authority.console.acts import Approved, Arguments, Conclude, ToApprove
from rossec.authority.console.questions import changed_by, is_about, longest, pending_of
from rossec.authority.console.sentences import given
from rossec.authority.policyfile import PolicyFile
from rossec.authority.requests import GrantRequestStore
from rossec.authority.service import AuthorityService
from rossec.clock import format_duration
from rossec.errors import ConfigurationError, KeyServiceRefused

_MALFORMED: Final = "the payload of an approval is malformed", "restore a backup"


class Answer(NamedTuple):
    """A payload: digest of the policy, rights that are answered, claims and rules of each grant."""

    policy: bytes
    rights: tuple[tuple[int, str], ...]
    grants: tuple[tuple[bytes, str], ...]

    def to_bytes(self) -> bytes:
        """Its encoding."""
        rights: list[Value] = [[*each] for each in self.rights]
        grants: list[Value] = [[*each] for each in self.grants]
        return encode([self.policy, rights, grants])

    @classmethod
    def from_bytes(cls, data: bytes) -> "Answer":
        """Read a payload of this record, whose digest was approved."""
        match decode(data, limit=MAX_PAYLOAD):
            case [bytes(policy), [*rights], [*grants]]:
                return cls(policy, tuple(map(_right, rights)), tuple(map(_grant, grants)))
            case _:
                raise ConfigurationError(*_MALFORMED)

    def drafts(self) -> list[tuple[Draft, str]]:
        """The grants to sign, with their rules."""
        return [(_draft(body), rules) for body, rules in self.grants]


class GrantAct:
    """Grants for a question: its id, a coarser filter, at most so many seconds (0: as asked)."""

    def __init__(self, policy: Path) -> None:
        self._policy = policy

    def prepare(self, service: AuthorityService, arguments: Arguments, now: int, /) -> ToApprove:
        """Make the grants, as they will be signed."""
        match arguments:
            case [bytes(question), str(coarse), int(seconds)] if seconds >= 0:
                pass
            case _:
                raise KeyServiceRefused("these are not the arguments of a grant", "")
        if service.home.is_intermediate:
            raise KeyServiceRefused("an intermediate signs no grants", "do it at the root")
        file = PolicyFile.read(self._policy, own=True)
        change = changed_by(file, coarse, seconds, now)
        with closing(ApprovalQueue(service.home, file, now)) as queue:
            found = pending_of(queue, question)
            check_seconds(seconds, min(longest(each.verdict) for each in found))
            made = queue.drafts(service.home.domain, found, change)
        issuer = thumbprint(service.home.own_key())
        answer = Answer(
            sha256(file.text.encode()).digest(),
            tuple(
                (int(each.stored.requested.right), each.stored.requested.pattern) for each in found
            ),
            tuple((encode(claims.from_draft(draft, issuer)), rules) for draft, rules in made),
        )
        payload = answer.to_bytes()
        return ToApprove(Grant(question, sha256(payload).digest()), payload)

    def admit(self, store: Store, approved: Approved, /) -> str | None:
        """The question is answered."""
        answer = Answer.from_bytes(approved.approval.payload)
        self._check_policy(answer)
        table, question = GrantRequestStore(store.database), approved.approval.subject
        found = {
            (int(each.requested.right), each.requested.pattern): each
            for each in table.unanswered()
            if is_about(each, question)
        }
        for right in answer.rights:
            if right not in found:
                raise _answered()
            table.answer(found[right], GRANTED, approved.reason, approved.approval.at)
        return None

    def carry_out(
        self, service: AuthorityService, approved: Approved, conclude: Conclude, now: int, /
    ) -> None:
        """Sign exactly these grants."""
        answer, authority = Answer.from_bytes(approved.approval.payload), service.unlock()
        drafts, issuer = answer.drafts(), thumbprint(authority.signer.public_key)
        for (draft, _), (body, _) in zip(drafts, answer.grants, strict=True):
            if encode(claims.from_draft(draft, issuer)) != body or now >= draft.expires:
                raise StoreError("the grants are over, or not for this authority", "ask again")

        def check() -> None:
            self._check_policy(answer)
            for draft, _ in drafts:
                held = authority.store.valid_certificate(draft.subject, now)
                if held.thumbprint != draft.holder:
                    raise StoreError(f"{draft.subject} has another key now", "it has to ask again")
            conclude(authority.store, given([body for body, _ in answer.grants]))

        for data in authority.issue_grants(drafts, now, check):
            service.store_grant(data)

    def made(self, _service: AuthorityService, approved: Approved, /) -> bytes:
        """The claims of the grants, as a CBOR list: what the node was given, and until when."""
        bodies: list[Value] = [
            body for body, _ in Answer.from_bytes(approved.approval.payload).grants
        ]
        return encode(bodies)

    def _check_policy(self, answer: Answer) -> None:
        """Return if the policy is the one by which the grants were made.

        Raises:
            ConfigurationError: it was changed.
        """
        file = PolicyFile.read(self._policy, own=True)
        if sha256(file.text.encode()).digest() != answer.policy:
            raise ConfigurationError("the policy was changed meanwhile", "look at it again")


def check_seconds(seconds: int, most: int) -> None:
    """Return if the policy allows a grant for so long; 0: as long as it allows.

    What was approved is what is signed: a month is not made seven days without a word.

    Raises:
        KeyServiceRefused: it does not.
    """
    if seconds > most:
        raise KeyServiceRefused(
            f"the policy allows this for {format_duration(most)} at most", "choose a shorter time"
        )


def _right(value: Value) -> tuple[int, str]:
    match value:
        case [int(right), str(pattern)]:
            return right, pattern
        case _:
            raise ConfigurationError(*_MALFORMED)


def _grant(value: Value) -> tuple[bytes, str]:
    match value:
        case [bytes(body), str(rules)]:
            return body, rules
        case _:
            raise ConfigurationError(*_MALFORMED)


def _draft(body: bytes) -> Draft:
    found = claims.read(body, bytes(ID_SIZE))
    return Draft(
        found.domain, found.subject, found.holder, found.not_before, found.expires, found.cap,
        found.serial, found.permissions,
    )  # fmt: skip


def _answered() -> StoreError:
    return StoreError("this question was answered", "look at what happened to it")
