import hashlib
import itertools
from collections.abc import Mapping

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ca.encoding import Value
from ca.errors import RevocationRefused
from ca.revocation import lists
from ca.revocation.lists import (
    LIST_PROFILE,
    MAX_ENTRIES,
    MAX_LIST,
    TIMESTAMP_PROFILE,
    RevocationList,
    Timestamp,
    check_entry,
    digest,
    open_list,
    open_timestamp,
    sign_list,
    sign_timestamp,
)
from tests.support.pki import NOW, new_signer

SIGNER = new_signer()
GRANT, KEY = bytes(range(16)), bytes(range(32))
LIST = RevocationList(1, 2, NOW, NOW + 86_400, frozenset({GRANT, KEY}))
STAMP = Timestamp(2, bytes(32), NOW, 30)

numbers = st.integers(0, 2**53 - 1)
entries = st.frozensets(st.binary(min_size=16, max_size=16) | st.binary(min_size=32, max_size=32))


@settings(max_examples=50)
@given(numbers, numbers, st.integers(0, 2**52), st.integers(1, 2**52 - 1), entries)
def test_lists_round_trip(epoch: int, seq: int, issued: int, life: int, held: frozenset[bytes]) -> None:
    revocations = RevocationList(epoch, seq, issued, issued + life, held)
    assert open_list(sign_list(SIGNER, revocations), SIGNER.public_key) == revocations
    assert revocations.number == (epoch, seq)


@settings(max_examples=50)
@given(numbers, st.binary(min_size=32, max_size=32), numbers, st.integers(1, 30))
def test_timestamps_round_trip(seq: int, held: bytes, issued: int, max_age: int) -> None:
    stamp = Timestamp(seq, held, issued, max_age)
    assert open_timestamp(sign_timestamp(SIGNER, stamp), SIGNER.public_key) == stamp


def test_the_largest_list_fits() -> None:
    full = frozenset(hashlib.sha256(n.to_bytes(2)).digest() for n in range(MAX_ENTRIES))
    data = sign_list(SIGNER, RevocationList(2**53 - 1, 2**53 - 1, NOW, NOW + 1, full))
    assert len(data) <= MAX_LIST
    assert open_list(data, SIGNER.public_key).entries == full
    with pytest.raises(RevocationRefused, match="of 4097 entries where at most 4096"):
        sign_list(SIGNER, RevocationList(1, 1, NOW, NOW + 1, full | {GRANT}))


def test_digest_is_sha256() -> None:
    assert digest(b"list") == hashlib.sha256(b"list").digest()


def test_the_two_are_not_taken_for_each_other() -> None:
    with pytest.raises(RevocationRefused, match="not a statement of kind rossec-timestamp"):
        open_timestamp(sign_list(SIGNER, LIST), SIGNER.public_key)
    with pytest.raises(RevocationRefused, match="not a statement of kind rossec-revocation"):
        open_list(sign_timestamp(SIGNER, STAMP), SIGNER.public_key)


def test_a_list_of_another_signer_is_refused() -> None:
    with pytest.raises(RevocationRefused, match="the signature does not verify") as caught:
        open_list(sign_list(new_signer(), LIST), SIGNER.public_key)
    assert "this node trusts" in caught.value.hint


def test_every_byte_of_a_list_counts() -> None:
    data = sign_list(SIGNER, LIST)
    for position, change in itertools.product(range(len(data)), (0x01, 0x80, 0xFF)):
        damaged = bytearray(data)
        damaged[position] ^= change
        with pytest.raises(RevocationRefused):
            open_list(bytes(damaged), SIGNER.public_key)


def test_every_byte_of_a_timestamp_counts() -> None:
    data = sign_timestamp(SIGNER, STAMP)
    for position, change in itertools.product(range(len(data)), (0x01, 0x80, 0xFF)):
        damaged = bytearray(data)
        damaged[position] ^= change
        with pytest.raises(RevocationRefused):
            open_timestamp(bytes(damaged), SIGNER.public_key)


def test_truncation_and_tail() -> None:
    data = sign_list(SIGNER, LIST)
    for damaged in [*(data[:size] for size in range(len(data))), data + b"\0"]:
        with pytest.raises(RevocationRefused):
            open_list(damaged, SIGNER.public_key)


def test_size_comes_first() -> None:
    with pytest.raises(RevocationRefused, match="bytes of CBOR where at most"):
        open_list(b"\xd2" + bytes(MAX_LIST + 1), SIGNER.public_key)
    with pytest.raises(RevocationRefused, match="bytes of CBOR where at most"):
        open_timestamp(b"\xd2" + bytes(513), SIGNER.public_key)


def list_payload(changes: Mapping[int | str, Value] | None = None) -> Value:
    good: dict[int | str, Value] = {4: NOW + 1, 6: NOW, -70001: 1, -70002: 2, -70003: [GRANT, KEY]}
    return good | dict(changes or {})


def test_the_crafted_payload_is_good_when_unchanged() -> None:
    data = LIST_PROFILE.sign(SIGNER, list_payload())
    assert open_list(data, SIGNER.public_key).entries == {GRANT, KEY}


@pytest.mark.parametrize(
    ("payload", "message"),
    [
        ([], "the revocation list has missing or unknown fields"),
        ({}, "the revocation list has missing or unknown fields"),
        (list_payload({7: 1}), "the revocation list has missing or unknown fields"),
        (list_payload({-70003: b""}), "the revocation list has missing or unknown fields"),
        (list_payload({4: NOW}), "expires before it is issued"),
        (list_payload({4: "x"}), "a number in the statement is out of range"),
        (list_payload({6: -1}), "a number in the statement is out of range"),
        (list_payload({6: True}), "a number in the statement is out of range"),
        (list_payload({6: 1.5}), "a number in the statement is out of range"),
        (list_payload({-70001: 2**53}), "a number in the statement is out of range"),
        (list_payload({-70002: None}), "a number in the statement is out of range"),
        (list_payload({-70003: [KEY, GRANT]}), "entries of the revocation list are not sorted"),
        (list_payload({-70003: [KEY, KEY]}), "entries of the revocation list are not sorted"),
        (list_payload({-70003: [b"short"]}), "an entry is a grant id of 16 bytes or"),
        (list_payload({-70003: ["x" * 16]}), "an entry is a grant id of 16 bytes or"),
    ],
)
def test_a_signed_statement_that_is_not_a_list(payload: Value, message: str) -> None:
    with pytest.raises(RevocationRefused, match=message):
        open_list(LIST_PROFILE.sign(SIGNER, payload), SIGNER.public_key)


def stamp_payload(changes: Mapping[int | str, Value]) -> Value:
    good: dict[int | str, Value] = {6: NOW, -70002: 2, -70004: bytes(32), -70005: 30}
    return good | dict(changes)


@pytest.mark.parametrize(
    ("payload", "message"),
    [
        (7, "the timestamp has missing or unknown fields"),
        (stamp_payload({4: 1}), "the timestamp has missing or unknown fields"),
        (stamp_payload({-70004: "x"}), "the timestamp has missing or unknown fields"),
        (stamp_payload({-70004: bytes(31)}), "the timestamp's digest does not have 32 bytes"),
        (stamp_payload({-70005: 31}), "a timestamp valid for 31 s where 1 to 30 are allowed"),
        (stamp_payload({-70005: 0}), "a timestamp valid for 0 s where 1 to 30 are allowed"),
        (stamp_payload({-70005: "x"}), "a number in the statement is out of range"),
        (stamp_payload({6: -1}), "a number in the statement is out of range"),
    ],
)
def test_a_signed_statement_that_is_not_a_timestamp(payload: Value, message: str) -> None:
    with pytest.raises(RevocationRefused, match=message):
        open_timestamp(TIMESTAMP_PROFILE.sign(SIGNER, payload), SIGNER.public_key)


def test_what_would_not_open_is_not_signed() -> None:
    with pytest.raises(RevocationRefused, match="expires before"):
        sign_list(SIGNER, RevocationList(1, 1, NOW, NOW, frozenset()))
    with pytest.raises(RevocationRefused, match="out of range"):
        sign_list(SIGNER, RevocationList(-1, 1, NOW, NOW + 1, frozenset()))
    with pytest.raises(RevocationRefused, match="an entry is"):
        sign_list(SIGNER, RevocationList(1, 1, NOW, NOW + 1, frozenset({b"x"})))
    with pytest.raises(RevocationRefused, match="valid for 31 s"):
        sign_timestamp(SIGNER, Timestamp(1, bytes(32), NOW, 31))


def test_entries_have_two_sizes() -> None:
    assert check_entry(GRANT) == GRANT
    assert check_entry(KEY) == KEY
    for entry in (b"", bytes(15), bytes(17), bytes(31), bytes(33), "x" * 16, None, bytearray(16)):
        with pytest.raises(RevocationRefused, match="a grant id of 16 bytes or a key thumbprint"):
            check_entry(entry)


def test_encoding_is_for_ever() -> None:
    """The bytes that are signed, pinned: old nodes and old lists outlive this release."""
    data = sign_list(SIGNER, RevocationList(1, 2, 3, 4, frozenset({GRANT})))
    payload = bytes.fromhex("a5 0404 0603 3a00011170 01 3a00011171 02 3a00011172 8150") + GRANT
    assert payload in data
    assert lists.LIST_PROFILE.typ.encode() in data
