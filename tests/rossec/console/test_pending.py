"""What waits for its session: acts for a passkey, join codes to be shown."""

from rossec.authority.console import messages
from rossec.console.sessions import SessionTable

ANNA, LOOKER = messages.of_phone("anna"), messages.of_looker(b"l")


def test_it_is_found_in_its_session_until_it_is_done() -> None:
    pending: SessionTable[str] = SessionTable(4)
    assert pending.add(b"1", b"session", "act", ANNA)
    assert pending.get(b"1", b"session") == "act"
    assert pending.pop(b"1", b"session") == "act"
    assert pending.get(b"1", b"session") is None
    assert pending.pop(b"2", b"session") is None


def test_another_session_neither_finds_nor_takes_it() -> None:
    pending: SessionTable[str] = SessionTable(4)
    pending.add(b"1", b"session", "act", ANNA)
    assert pending.get(b"1", b"other") is None
    assert pending.pop(b"1", b"other") is None
    assert pending.pop(b"1", b"session") == "act"


def test_the_oldest_makes_room_and_nothing_of_a_phone_for_who_only_looks() -> None:
    pending: SessionTable[str] = SessionTable(2)
    for key in (b"1", b"2", b"3"):
        assert pending.add(key, b"session", "act", ANNA)
    assert [pending.get(key, b"session") for key in (b"1", b"2", b"3")] == [None, "act", "act"]
    assert not pending.add(b"4", b"other", "act", LOOKER)
