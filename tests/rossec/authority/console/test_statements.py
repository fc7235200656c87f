"""Statements that wait for a touch: used once, few, and not longer than their time."""

import pytest

from ca.approvals.statement import Enroll, RevokeMaster, Statement, StatementKind
from ca.errors import ApprovalRefused
from rossec.authority.console import messages
from rossec.authority.console.approving import MAX_OF_KIND, Statements
from rossec.errors import KeyServiceRefused
from tests.support import refusal_texts
from tests.support.approving import NOW, WHATS, state


class Time:
    elapsed = 0.0


@pytest.fixture
def time() -> Time:
    return Time()


@pytest.fixture
def statements(time: Time) -> Statements:
    return Statements(lambda: time.elapsed)


def add(
    statements: Statements, number: int = 1, kind: StatementKind = StatementKind.ENROLL, owner: str = ""
) -> Statement:
    statement = state(WHATS[kind], id=number.to_bytes(16))
    statements.add(statement, b"payload", owner)
    return statement


def test_a_statement_is_taken_once(statements: Statements) -> None:
    statement = add(statements)
    found = statements.take(statement.id, NOW)
    assert isinstance(found.statement.what, Enroll)
    assert found[:2] == (statement, b"payload")
    for number in (statement.id, bytes(16)):
        with pytest.raises(ApprovalRefused, match="not waiting"):
            statements.take(number, NOW)


def test_it_ends_by_both_clocks(statements: Statements, time: Time) -> None:
    statement = add(statements)
    time.elapsed = 299.9
    assert statements.take(statement.id, NOW + 300)
    time.elapsed = 0.0
    for at in (NOW - 1, NOW + 301):
        statement = add(statements)
        with pytest.raises(ApprovalRefused, match="too late, or the clock was set"):
            statements.take(statement.id, at)
    statement = add(statements)
    time.elapsed = 300.0
    with pytest.raises(ApprovalRefused, match="not waiting"):
        statements.take(statement.id, NOW)


def test_there_are_few_of_each_kind_and_the_oldest_goes(statements: Statements) -> None:
    other = add(statements, 1000, StatementKind.REVOKE_MASTER)
    made = [add(statements, number) for number in range(MAX_OF_KIND + 1)]
    with pytest.raises(ApprovalRefused, match=refusal_texts.APPROVAL_OUTDATED):
        statements.take(made[0].id, NOW)
    assert all(statements.take(each.id, NOW) for each in made[1:])
    assert isinstance(statements.take(other.id, NOW).statement.what, RevokeMaster)


@pytest.mark.attack("looker-floods")
def test_whoever_only_looks_ends_nothing_of_a_phone(statements: Statements) -> None:
    phone, looker = messages.of_phone("Anna's"), messages.of_looker(b"1")
    first = add(statements, 1, owner=phone)
    for number in range(2, 200):
        add(statements, number, owner=looker)
    assert statements.take(first.id, NOW)
    full = [add(statements, 1000 + number, owner=phone) for number in range(MAX_OF_KIND)]
    with pytest.raises(KeyServiceRefused):
        add(statements, 2000, owner=looker)
    assert all(statements.take(each.id, NOW) for each in full)
