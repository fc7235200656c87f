"""The journal of deposits: changes are read as written, and only complete records."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.master.state import journals
from rossec.master.state.journals import (
    DEPOSITS_MAGIC,
    DepositChange,
    GrantDeposited,
    GrantHeld,
    decode_deposits,
    encode_deposit,
)

CHANGES: list[DepositChange] = [GrantDeposited(b"a grant"), GrantHeld(b"i" * 16), GrantDeposited(b"\0" * 300)]
WHOLE = DEPOSITS_MAGIC + b"".join(map(encode_deposit, CHANGES))


def test_decode_inverts_encode() -> None:
    assert decode_deposits(WHOLE) == (CHANGES, len(WHOLE))
    assert decode_deposits(DEPOSITS_MAGIC) == ([], len(DEPOSITS_MAGIC))
    assert decode_deposits(b"rossec deposits 2\n" + WHOLE) == ([], 0), "another version"


@given(st.integers(0, len(WHOLE) - 1))
def test_a_truncated_record_ends_the_journal(size: int) -> None:
    changes, good = decode_deposits(WHOLE[:size])
    assert changes == CHANGES[: len(changes)]
    assert decode_deposits(WHOLE[:good]) == (changes, good)


@pytest.mark.parametrize("content", [b"", b"G", b"H", b"H" + b"i" * 15, b"H" + b"i" * 17, b"Xyz"])
def test_an_unknown_record_ends_the_journal(content: bytes) -> None:
    data = DEPOSITS_MAGIC + encode_deposit(CHANGES[0]) + journals.frame(content) + encode_deposit(CHANGES[1])
    assert decode_deposits(data) == ([CHANGES[0]], len(DEPOSITS_MAGIC + encode_deposit(CHANGES[0])))
