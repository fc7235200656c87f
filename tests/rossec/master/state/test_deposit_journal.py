"""The journal of deposits: changes are read as written, and only complete records."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.master.state import journal_records
from rossec.master.state.deposit_journal import (
    MAGIC,
    DepositChange,
    GrantDeposited,
    GrantHeld,
    decode,
    encode,
)

CHANGES: list[DepositChange] = [
    GrantDeposited(b"a grant"),
    GrantHeld(b"i" * 16),
    GrantDeposited(b"\0" * 300),
]
WHOLE = MAGIC + b"".join(map(encode, CHANGES))


def test_decode_inverts_encode() -> None:
    assert decode(WHOLE) == (CHANGES, len(WHOLE))
    assert decode(MAGIC) == ([], len(MAGIC))
    assert decode(b"rossec deposits 2\n" + WHOLE) == ([], 0), "another version"


@given(st.integers(0, len(WHOLE) - 1))
def test_a_truncated_record_ends_the_journal(size: int) -> None:
    changes, good = decode(WHOLE[:size])
    assert changes == CHANGES[: len(changes)]
    assert decode(WHOLE[:good]) == (changes, good)


@pytest.mark.parametrize("content", [b"", b"G", b"H", b"H" + b"i" * 15, b"H" + b"i" * 17, b"Xyz"])
def test_an_unknown_record_ends_the_journal(content: bytes) -> None:
    data = MAGIC + encode(CHANGES[0]) + journal_records.frame(content) + encode(CHANGES[1])
    assert decode(data) == ([CHANGES[0]], len(MAGIC + encode(CHANGES[0])))
