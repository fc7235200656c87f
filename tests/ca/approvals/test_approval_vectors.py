"""The published vectors of approvals: what the specification says, computed from their inputs."""

import json

from ca.approvals.passkeys import Approval, ApprovalVerifier, Assertion, Registration, register
from ca.approvals.statement import Statement, StatementKind
from tests.support.approving import WHATS, state
from tests.vectors.make_approvals import CREATION, FILE, GRANT, vectors

V = json.loads(FILE.read_text())


def test_each_kind_has_its_statement() -> None:
    assert set(V["statements"]) == {kind.name.lower() for kind in StatementKind}
    for name, vector in V["statements"].items():
        statement = Statement.from_bytes(bytes.fromhex(vector["statement"]))
        assert statement == state(WHATS[StatementKind[name.upper()]])
        assert statement.challenge.hex() == vector["challenge"]


def test_a_registration_and_an_approval_by_it() -> None:
    made = Registration(*(bytes.fromhex(data) for data in V["registration"].values()))
    passkey = register(made, CREATION, "phone", V["now"])
    assert passkey.cose_key.hex() == V["cose_key"]
    assert (passkey.origin, passkey.rp_id) == (V["origin"], V["rp_id"])
    fields = {name: bytes.fromhex(data) for name, data in V["approval"].items()}
    statement, payload = fields.pop("statement"), fields.pop("payload")
    assertion = Assertion(**fields)
    approval = Approval.of(Statement.from_bytes(statement), payload, assertion, V["now"])
    assert ApprovalVerifier([passkey]).verify(approval) == GRANT


def test_the_vectors_are_those_that_are_made() -> None:
    made = vectors()
    for signed in (made["approval"], V["approval"]):
        assert len(bytes.fromhex(signed.pop("signature"))) <= 72
    assert made == V
