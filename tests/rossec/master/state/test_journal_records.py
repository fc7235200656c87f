"""Records of a journal: read as written, and only complete ones."""

from hypothesis import given
from hypothesis import strategies as st

from rossec.master.state.journals import contents, frame

ITEMS = [b"one", b"", b"three" * 100]
WHOLE = b"magic" + b"".join(map(frame, ITEMS))


def test_the_records_are_read_with_their_ends() -> None:
    found = list(contents(WHOLE, 5))
    assert [content for content, _ in found] == ITEMS
    assert [end for _, end in found] == [5 + 11, 5 + 11 + 8, len(WHOLE)]
    assert list(contents(WHOLE, len(WHOLE))) == []


@given(st.integers(5, len(WHOLE) - 1))
def test_a_truncated_record_ends_the_journal(size: int) -> None:
    found = [content for content, _ in contents(WHOLE[:size], 5)]
    assert found == ITEMS[: len(found)]
    assert len(found) < len(ITEMS)


@given(st.integers(5, len(WHOLE) - 1), st.integers(1, 255))
def test_a_damaged_record_ends_the_journal(at: int, flip: int) -> None:
    damaged = bytearray(WHOLE)
    damaged[at] ^= flip
    found = [content for content, _ in contents(bytes(damaged), 5)]
    assert found == ITEMS[: len(found)]
    assert len(found) < len(ITEMS)
