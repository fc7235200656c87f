import hashlib
from typing import Any

import pytest

from ca.approvals.passkeys import Approval, ApprovalVerifier, Assertion
from ca.approvals.statement import LIFETIME, GrantStatement, StatementKind
from ca.errors import ApprovalRefused
from tests.support import passkeys, refusal_texts
from tests.support.approving import NOW, WHATS, registered, state, touch

DEVICE = passkeys.Passkey()
PAYLOAD = b"claims"
STATEMENT = state(GrantStatement(b"r" * 16, hashlib.sha256(PAYLOAD).digest()))


@pytest.fixture
def device() -> passkeys.Passkey:
    return passkeys.Passkey()


def test_an_approval_has_the_fields_of_its_statement(device: passkeys.Passkey) -> None:
    assertion = Assertion(*device.sign(STATEMENT.challenge))
    approval = Approval.of(STATEMENT, PAYLOAD, assertion, NOW)
    assert approval.read() == STATEMENT
    assert approval.assertion == assertion
    assert (approval.id, approval.kind, approval.subject) == (b"i" * 16, 2, b"r" * 16)


def test_approvals_are_verified_in_order(device: passkeys.Passkey) -> None:
    first, second = (touch(STATEMENT, PAYLOAD, device) for _ in range(2))
    verifier = ApprovalVerifier([registered(device)])
    assert verifier.verify(first) == verifier.verify(second) == STATEMENT
    with pytest.raises(ApprovalRefused, match=refusal_texts.PASSKEY_CLONED):
        verifier.verify(first)
    with pytest.raises(ApprovalRefused, match=refusal_texts.PASSKEY_CLONED):
        ApprovalVerifier([registered(device)], [(device.id, 2)]).verify(second)


def test_the_passkey_must_be_known(device: passkeys.Passkey) -> None:
    verifier = ApprovalVerifier([])
    with pytest.raises(ApprovalRefused, match="is not known"):
        verifier.verify(touch(STATEMENT, PAYLOAD, device))
    verifier.add_passkey(registered(device))
    verifier.verify(touch(STATEMENT, PAYLOAD, device))


def test_an_assertion_for_another_statement_is_refused(device: passkeys.Passkey) -> None:
    for other in (
        STATEMENT._replace(id=b"x" * 16),
        STATEMENT._replace(until=NOW + 1),
        STATEMENT._replace(domain="other"),
        STATEMENT._replace(log_size=1),
    ):
        assertion = Assertion(*device.sign(STATEMENT.challenge))
        approval = Approval.of(other, PAYLOAD, assertion, NOW)
        with pytest.raises(ApprovalRefused, match=refusal_texts.OTHER_CHALLENGE):
            ApprovalVerifier([registered(device)]).verify(approval)


@pytest.mark.parametrize(
    "change",
    [{"id": b"x" * 16}, {"kind": int(StatementKind.ENROLL)}, {"subject": b"s"}],
    ids=lambda change: next(iter(change)),
)
def test_fields_of_another_statement_are_refused(change: dict[str, Any]) -> None:
    approval = touch(STATEMENT, PAYLOAD)._replace(**change)
    with pytest.raises(ApprovalRefused, match="another's statement"):
        approval.read()


def test_another_payload_is_refused() -> None:
    with pytest.raises(ApprovalRefused, match="not what was shown"):
        touch(STATEMENT, b"wider").read()


@pytest.mark.parametrize("at", [NOW - 1, NOW + LIFETIME + 1])
def test_an_approval_at_another_time_is_refused(at: int) -> None:
    with pytest.raises(ApprovalRefused, match="did not come in time"):
        touch(STATEMENT, PAYLOAD, at=at).read()
    for within in (NOW, NOW + LIFETIME):
        touch(state(WHATS[StatementKind.DELEGATE]), at=within).read()
