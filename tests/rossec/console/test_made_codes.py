"""Which session may still see the join code that it made."""

from rossec.console.approvals import MAX_CODES, MadeCodes


def test_a_code_is_for_the_session_that_made_it_and_once() -> None:
    codes = MadeCodes()
    codes.add(b"1", b"anna")
    assert not codes.take(b"1", b"ben")
    assert not codes.take(b"2", b"anna")
    assert codes.take(b"1", b"anna")
    assert not codes.take(b"1", b"anna")


def test_the_oldest_makes_room() -> None:
    codes = MadeCodes()
    for number in range(MAX_CODES + 1):
        codes.add(number.to_bytes(2), b"anna")
    assert not codes.take((0).to_bytes(2), b"anna")
    assert codes.take((1).to_bytes(2), b"anna")
