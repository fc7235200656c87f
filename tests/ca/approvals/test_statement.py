import hashlib
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.approvals.statement import (
    LIFETIME,
    MAX_PAYLOAD,
    MAX_STATEMENT,
    VERSION,
    DelegateStatement,
    Enroll,
    ForeignDomainStatement,
    GrantStatement,
    IntermediateStatement,
    Invitation,
    NewPasskey,
    PolicyChange,
    RevokeMaster,
    Statement,
    StatementKind,
)
from ca.encoding import Value, decode, encode
from ca.errors import ApprovalRefused
from tests.support import refusal_texts
from tests.support.approving import NOW, WHATS, state

digests = st.binary(min_size=32, max_size=32)
ids = st.binary(min_size=16, max_size=16)
numbers = st.integers(0, (1 << 53) - 1)
texts = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=64)
whats = st.one_of(
    st.builds(Enroll, digests, texts, digests, st.booleans(), numbers, st.booleans()),
    st.builds(GrantStatement, ids, digests),
    st.builds(PolicyChange, digests, digests, digests),
    st.builds(DelegateStatement, digests, numbers, numbers),
    st.builds(IntermediateStatement, digests, st.booleans(), numbers),
    st.builds(NewPasskey, st.binary(min_size=1, max_size=1023), digests, texts),
    st.builds(Invitation, texts, numbers, numbers, st.booleans()),
    st.builds(ForeignDomainStatement, digests),
    st.builds(RevokeMaster, st.one_of(texts, st.just("")), st.sampled_from(["/master", "/master/kitchen"])),
)


@st.composite
def statements(draw: st.DrawFn) -> Statement:
    what = draw(whats)
    made = draw(st.integers(0, 1 << 40))
    until = made + draw(st.integers(1, LIFETIME))
    return state(what)._replace(
        id=draw(ids),
        domain=draw(texts),
        made=made,
        until=until,
        log_size=draw(numbers),
        log_root=draw(digests),
    )


def test_the_first_master_is_left_out_as_before_there_were_others() -> None:
    """So what was approved then is still read, and each statement has one encoding."""
    first = state(RevokeMaster("stolen")).to_bytes()
    head = decode(first)
    assert isinstance(head, list)
    assert head[-1] == ["stolen"]
    assert Statement.from_bytes(first).what == RevokeMaster("stolen", "/master")
    others: tuple[list[Value], ...] = (["stolen", "/master"], ["stolen", "/robot"], ["stolen", ""], [])
    for fields in others:
        with pytest.raises(ApprovalRefused, match=refusal_texts.STATEMENT_REFUSED):
            Statement.from_bytes(encode([*head[:-1], fields]))


@given(statements())
def test_a_statement_comes_back(statement: Statement) -> None:
    found = Statement.from_bytes(statement.to_bytes())
    assert found == statement
    assert type(found.what) is type(statement.what)


@given(statements(), statements())
def test_no_two_statements_have_one_challenge(first: Statement, second: Statement) -> None:
    same = first == second and type(first.what) is type(second.what)
    assert (first.challenge == second.challenge) == same


@given(statements(), st.data())
def test_another_byte_is_another_challenge_or_no_statement(statement: Statement, data: st.DataObject) -> None:
    encoded = bytearray(statement.to_bytes())
    encoded[data.draw(st.integers(0, len(encoded) - 1))] ^= data.draw(st.integers(1, 255))
    try:
        found = Statement.from_bytes(bytes(encoded))
    except ApprovalRefused:
        return
    assert found != statement
    assert found.challenge != statement.challenge
    assert found.to_bytes() == encoded


def test_each_kind_has_a_form() -> None:
    assert set(WHATS) == set(StatementKind)
    for kind, what in WHATS.items():
        value = decode(state(what).to_bytes())
        assert isinstance(value, list)
        assert value[:2] == [VERSION, kind]


def test_the_challenge_is_the_digest_of_the_encoding() -> None:
    statement = state(WHATS[StatementKind.GRANT])
    assert statement.challenge == hashlib.sha256(statement.to_bytes()).digest()


@pytest.mark.parametrize("size", [0, 1, 20, -1])
def test_a_truncated_or_longer_statement_is_refused(size: int) -> None:
    encoded = state(WHATS[StatementKind.ENROLL]).to_bytes()
    for data in (encoded[:size], encoded + bytes(abs(size) or 1)):
        with pytest.raises(ApprovalRefused, match="not a statement"):
            Statement.from_bytes(data)


def test_a_large_statement_is_refused_before_it_is_parsed() -> None:
    with pytest.raises(ApprovalRefused, match=f"at most {MAX_STATEMENT} are allowed"):
        Statement.from_bytes(bytes(MAX_STATEMENT + 1))


HEAD: list[Any] = [VERSION, 2, b"i" * 16, "home", NOW, NOW + 300, [0, bytes(32)]]
GRANT = [b"r" * 16, bytes(32)]


@pytest.mark.parametrize(
    "value",
    [
        [],
        {},
        [*HEAD],
        [*HEAD, GRANT, 0],
        [*HEAD, [*GRANT, 0]],
        [*HEAD, GRANT[:1]],
        [*HEAD, [b"r" * 15, bytes(32)]],
        [*HEAD, [b"r" * 16, bytes(31)]],
        [*HEAD, {}],
        ["rossec-approval-v2", *HEAD[1:], GRANT],
        ["rossec-login-v1", *HEAD[1:], GRANT],
        [VERSION, 0, *HEAD[2:], GRANT],
        [VERSION, 10, *HEAD[2:], GRANT],
        [VERSION, 3, *HEAD[2:], GRANT],
        [VERSION, "2", *HEAD[2:], GRANT],
        [VERSION, 2, b"i" * 15, *HEAD[3:], GRANT],
        [VERSION, 2, b"i" * 16, "", *HEAD[4:], GRANT],
        [VERSION, 2, b"i" * 16, b"home", *HEAD[4:], GRANT],
        [*HEAD[:4], NOW, NOW, HEAD[6], GRANT],
        [*HEAD[:4], NOW, NOW + 301, HEAD[6], GRANT],
        [*HEAD[:4], -1, 1, HEAD[6], GRANT],
        [*HEAD[:4], True, 2, HEAD[6], GRANT],
        [*HEAD[:4], float(NOW) + 0.5, NOW + 300, HEAD[6], GRANT],
        [*HEAD[:4], 1 << 53, (1 << 53) + 1, HEAD[6], GRANT],
        [*HEAD[:6], [-1, bytes(32)], GRANT],
        [*HEAD[:6], [0, bytes(33)], GRANT],
        [*HEAD[:6], [0], GRANT],
        [VERSION, True, *HEAD[2:], [bytes(32), "/a", bytes(32), False, 1, False]],
        [VERSION, 1, *HEAD[2:], [bytes(32), "/a", bytes(32), 0, 1, False]],
        [VERSION, 1, *HEAD[2:], [bytes(32), "/a", bytes(32), False, True, False]],
        [VERSION, 6, *HEAD[2:], [bytes(1024), bytes(32), "phone"]],
        [VERSION, 6, *HEAD[2:], [b"", bytes(32), "phone"]],
        [VERSION, 9, *HEAD[2:], ["x" * 1025]],
    ],
)
def test_anything_else_is_refused(value: Any) -> None:
    with pytest.raises(ApprovalRefused, match=refusal_texts.STATEMENT_REFUSED):
        Statement.from_bytes(encode(value))


@pytest.mark.parametrize(
    "statement",
    [
        state(WHATS[StatementKind.GRANT])._replace(kind=StatementKind.ENROLL),
        state(WHATS[StatementKind.GRANT])._replace(domain="\ud800"),
        state(WHATS[StatementKind.GRANT])._replace(until=NOW),
        state(GrantStatement(b"r", bytes(32))),
        state(Enroll(bytes(32), "", bytes(32), wildcard=False, lifetime=1, replaces=False)),
        state(DelegateStatement(bytes(32), -1, 1)),
    ],
)
def test_what_is_no_statement_is_not_written(statement: Statement) -> None:
    with pytest.raises(ApprovalRefused, match=refusal_texts.STATEMENT_REFUSED):
        statement.to_bytes()


@pytest.mark.parametrize("kind", sorted(StatementKind))
def test_a_payload_is_the_one_of_the_digest(kind: StatementKind) -> None:
    payload = b"shown"
    digest = hashlib.sha256(payload).digest()
    fields = {
        StatementKind.ENROLL: "csr",
        StatementKind.GRANT: "payload",
        StatementKind.POLICY: "new",
        StatementKind.INTERMEDIATE: "csr",
    }
    what = WHATS[kind]
    if kind in fields:
        what = type(what)(**{**what._asdict(), fields[kind]: digest})
        state(what).check_payload(payload)
        with pytest.raises(ApprovalRefused, match="not what was shown"):
            state(what).check_payload(b"")
    else:
        state(what).check_payload(b"")
        with pytest.raises(ApprovalRefused, match="not what was shown"):
            state(what).check_payload(payload)
    with pytest.raises(ApprovalRefused, match="too large"):
        state(what).check_payload(bytes(MAX_PAYLOAD + 1))


def test_a_statement_is_about_what_it_answers() -> None:
    subjects = {kind: state(what).subject for kind, what in WHATS.items()}
    assert subjects[StatementKind.GRANT] == b"r" * 16
    assert subjects[StatementKind.PASSKEY] == b"credential"
    assert subjects[StatementKind.POLICY] == PolicyChange(*WHATS[StatementKind.POLICY]).new
    assert subjects[StatementKind.INVITATION] == subjects[StatementKind.REVOKE_MASTER] == b""
