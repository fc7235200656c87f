"""A recorded approval, and its verification from the record alone. Pure.

Everything that convinced the service is kept: statement, payload, assertion. Whoever has the record
and trusts that its passkeys are theirs can check later that every act was approved by a touch.
"""

from collections.abc import Iterable
from typing import NamedTuple, Self

from ca.approvals.assertion import Assertion, Passkey, verify
from ca.approvals.statement import Statement
from ca.errors import ApprovalOutdated, PasskeyUnknown, StatementRefused


class Approval(NamedTuple):
    """One approval; `kind` and `subject` are those of its statement."""

    id: bytes
    kind: int
    subject: bytes
    statement: bytes
    payload: bytes
    passkey: bytes
    client_data: bytes
    authenticator_data: bytes
    signature: bytes
    at: int

    @classmethod
    def of(cls, statement: Statement, payload: bytes, assertion: Assertion, at: int) -> Self:
        """The approval of `statement` by `assertion`, not verified."""
        return cls(
            statement.id, int(statement.kind), statement.subject, statement.to_bytes(), payload,
            *assertion, at,
        )  # fmt: skip

    @property
    def assertion(self) -> Assertion:
        """What the passkey signed."""
        return Assertion(self.passkey, self.client_data, self.authenticator_data, self.signature)

    def read(self) -> Statement:
        """The statement, if the other fields agree with it. Signatures: see `ApprovalVerifier`.

        Raises:
            StatementRefused: malformed, or the fields or the payload are of another statement.
            ApprovalOutdated: approved before it was made, or too late.
        """
        statement = Statement.from_bytes(self.statement)
        if (self.id, self.kind, self.subject) != (
            statement.id, int(statement.kind), statement.subject,
        ):  # fmt: skip
            raise StatementRefused("the approval is recorded with another's statement", "")
        statement.check_payload(self.payload)
        if not statement.made <= self.at <= statement.until:
            raise ApprovalOutdated(
                "the approval did not come in time", "look at the page again, and approve that"
            )
        return statement


class ApprovalVerifier:
    """Verifies approvals, in the order in which they were made.

    `counters`: those of the passkeys before, by credential id.
    """

    def __init__(
        self, passkeys: Iterable[Passkey], counters: Iterable[tuple[bytes, int]] = ()
    ) -> None:
        self._passkeys = {passkey.id: passkey for passkey in passkeys}
        self._counters = dict(counters)

    def add_passkey(self, passkey: Passkey) -> None:
        """Know another passkey from now on."""
        self._passkeys[passkey.id] = passkey

    def verify(self, approval: Approval) -> Statement:
        """The statement that this approval approves.

        Raises:
            StatementRefused, ApprovalOutdated: as `Approval.read`.
            PasskeyUnknown: no passkey of this id is known.
            ApprovalRefused: as `ca.approvals.assertion.verify`.
        """
        statement = approval.read()
        passkey = self._passkeys.get(approval.passkey)
        if passkey is None:
            raise PasskeyUnknown("the passkey of this approval is not known", "is it registered?")
        last = self._counters.get(passkey.id, 0)
        self._counters[passkey.id] = verify(approval.assertion, passkey, statement.challenge, last)
        return statement
