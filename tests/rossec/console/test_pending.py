"""Acts that wait for a passkey."""

import pytest

from rossec.console.approvals import MAX_PENDING, PendingActs, ProposedAct
from rossec.errors import HttpRefused

ACT = ProposedAct("passkey", [b"a"], "/phones")


def test_an_act_is_found_in_its_session_until_it_is_done() -> None:
    pending = PendingActs()
    pending.add(b"1", b"session", ACT)
    assert pending.get(b"1", b"session") is ACT
    pending.remove(b"1")
    for statement, session in ((b"1", b"session"), (b"2", b"session")):
        with pytest.raises(HttpRefused):
            pending.get(statement, session)


def test_another_session_does_not_find_it() -> None:
    pending = PendingActs()
    pending.add(b"1", b"session", ACT)
    with pytest.raises(HttpRefused, match="was not asked here"):
        pending.get(b"1", b"other")


def test_the_oldest_makes_room() -> None:
    pending = PendingActs()
    for number in range(MAX_PENDING + 1):
        pending.add(bytes([number % 256, number // 256]), b"session", ACT)
    with pytest.raises(HttpRefused):
        pending.get(bytes([0, 0]), b"session")
    assert pending.get(bytes([1, 0]), b"session") is ACT
