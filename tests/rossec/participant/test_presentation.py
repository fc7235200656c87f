"""Tokens that are shown at once: in number and bytes what the other side reads."""

from ca.encoding import Value, encode
from rossec.participant.access import MAX_CALL, MAX_CALL_BYTES, MAX_GRANTS, MAX_PRESENTED, batches, fitting


def test_a_header_field_holds_what_its_reader_accepts() -> None:
    assert list(fitting([])) == []
    assert list(fitting([b"t"] * 20)) == [b"t"] * MAX_GRANTS
    for size in (100, 255, 256, 3000, 10_000, 20_000, MAX_PRESENTED - 8):
        shown: list[Value] = list(fitting([bytes(size)] * MAX_GRANTS))
        assert shown
        assert len(encode(shown)) <= MAX_PRESENTED
        assert len(shown) == MAX_GRANTS or len(encode([*shown, bytes(size)])) > MAX_PRESENTED - 64


def test_a_token_without_room_does_not_hide_the_smaller_ones() -> None:
    assert list(fitting([bytes(MAX_PRESENTED), b"small"])) == [b"small"]


def test_calls_are_bounded_in_number_and_bytes() -> None:
    assert list(batches([])) == []
    assert [len(each) for each in batches([b"t"] * (2 * MAX_CALL + 1))] == [MAX_CALL, MAX_CALL, 1]
    large = [bytes([n]) * 40_000 for n in range(30)]
    found = list(batches(large))
    assert [token for each in found for token in each] == large
    assert all(sum(map(len, each)) <= MAX_CALL_BYTES for each in found)
    assert len(found) == 3
