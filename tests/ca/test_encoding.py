import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.encoding import MAX_DEPTH, MAX_SIZE, Value, decode, decode_sequence, encode, head, parse
from ca.errors import EncodingError

leaves = (
    st.none()
    | st.booleans()
    | st.integers(-(2**64), 2**64 - 1)
    | st.floats(allow_nan=False)
    | st.text(st.characters(exclude_categories=["Cs"]))
    | st.binary()
)
values = st.recursive(
    leaves,
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.integers(-(2**64), 2**64 - 1) | st.text(max_size=5), inner, max_size=4)
    ),
    max_leaves=20,
)


@given(values)
def test_round_trip(value: Value) -> None:
    assert decode(encode(value)) == value


@given(st.binary(max_size=60))
def test_what_decodes_is_deterministic(data: bytes) -> None:
    try:
        value = decode(data)
    except EncodingError:
        return
    assert encode(value) == data


@given(values)
def test_every_truncation_and_a_tail(value: Value) -> None:
    data = encode(value)
    for cut in range(len(data)):
        with pytest.raises(EncodingError):
            decode(data[:cut])
    with pytest.raises(EncodingError, match="expected one CBOR item, found 2"):
        decode(data + b"\xf6")


@pytest.mark.parametrize(
    ("value", "data"),
    [
        (0, "00"),
        (23, "17"),
        (24, "1818"),
        (-1, "20"),
        (2**64 - 1, "1bffffffffffffffff"),
        (-(2**64), "3bffffffffffffffff"),
        (1.5, "f93e00"),
        (math.inf, "f97c00"),
        (b"", "40"),
        ("ä", "62c3a4"),
        ([], "80"),
        ({}, "a0"),
        (True, "f5"),
        (None, "f6"),
        ({-1: 0, 10: 1, 100: 2, "a": 3}, "a40a012000186402616103"),
    ],
)
def test_vectors(value: Value, data: str) -> None:
    assert encode(value).hex() == data
    assert decode(bytes.fromhex(data)) == value


@pytest.mark.parametrize(
    "data",
    [
        "1817",
        "190018",
        "1b0000000000000001",
        "fa3fc00000",
        "fb3ff8000000000000",
        "5800",
        "a2616100616200ff",
        "a20a00200000",
        "a220000a00",
        "f97e00",
    ],
)
def test_other_encodings_of_the_same_value(data: str) -> None:
    with pytest.raises(EncodingError):
        decode(bytes.fromhex(data))


def test_an_encoding_that_is_not_deterministic_is_refused() -> None:
    with pytest.raises(EncodingError, match="CBOR that is not in its deterministic form"):
        decode(bytes.fromhex("1817"))


@pytest.mark.parametrize(
    "data", ["", "18", "61ff", "9fff", "5f4100ff", "bfff", "ff", "1c", "a1000000", "a2000000", "f8"]
)
def test_malformed_cbor_is_refused(data: str) -> None:
    with pytest.raises(EncodingError):
        decode(bytes.fromhex(data))


@pytest.mark.parametrize("data", ["61ff", "9fff", "a200000000", "1c"])
def test_malformed_is_said(data: str) -> None:
    with pytest.raises(EncodingError, match="malformed CBOR"):
        decode(bytes.fromhex(data))


def test_duplicate_keys() -> None:
    with pytest.raises(EncodingError, match="malformed CBOR"):
        decode(bytes.fromhex("a200010002"))


@pytest.mark.parametrize("tag", [*range(300), 1004, 43000, 55799, 2**32, 2**64 - 1])
def test_every_tag_is_refused_uninterpreted(tag: int) -> None:
    for content in ("00", "40", "60", "80", "6161", "820001"):
        head = next(
            bytes([0xC0 | info]) + tag.to_bytes(size)
            for info, size in ((24, 1), (25, 2), (26, 4), (27, 8))
            if tag < 1 << 8 * size
        )
        short = bytes([0xC0 | tag]) if tag < 24 else head
        with pytest.raises(EncodingError, match="malformed CBOR"):
            decode(short + bytes.fromhex(content))


def test_size_comes_first() -> None:
    with pytest.raises(EncodingError, match="16385 bytes of CBOR where at most 16384 are allowed"):
        decode(bytes(MAX_SIZE + 1))
    with pytest.raises(EncodingError, match="3 bytes of CBOR where at most 2 are allowed"):
        decode(bytes(3), limit=2)


def nested(depth: int) -> Value:
    value: Value = 0
    for _ in range(depth):
        value = [value]
    return value


def test_depth_has_an_end() -> None:
    with pytest.raises(EncodingError, match="CBOR nested deeper than 16"):
        encode(nested(MAX_DEPTH + 1))
    for levels in (MAX_DEPTH + 1, 5000):
        with pytest.raises(EncodingError):
            decode(b"\x81" * levels + b"\x00")
    assert decode(encode(nested(MAX_DEPTH - 1))) == nested(MAX_DEPTH - 1)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (2**64, "integer beyond 64 bits"),
        (-(2**64) - 1, "integer beyond 64 bits"),
        (math.nan, "NaN has no deterministic encoding"),
        ((1, 2), "tuple is not in rossec's CBOR subset"),
        ({1}, "set is not in rossec's CBOR subset"),
        ({True: 1}, "map key that is neither integer nor text"),
        ({b"k": 1}, "map key that is neither integer nor text"),
        ({None: 1}, "map key that is neither integer nor text"),
        ({2**64: 1}, "integer beyond 64 bits"),
        ([{1: [object()]}], "object is not in rossec's CBOR subset"),
    ],
)
def test_outside_the_subset(value: Value, message: str) -> None:
    with pytest.raises(EncodingError, match=re.escape(message)):
        encode(value)


def test_simple_values_are_outside_the_subset() -> None:
    for data in ("f7", "e0", "f820"):
        with pytest.raises(EncodingError):
            decode(bytes.fromhex(data))


@given(st.lists(values, max_size=4))
def test_sequences_round_trip(items: list[Value]) -> None:
    assert decode_sequence(b"".join(map(encode, items))) == items


def test_sequences_have_a_size_too() -> None:
    assert decode_sequence(b"") == []
    with pytest.raises(EncodingError, match="expected one CBOR item, found 0"):
        decode(b"")
    with pytest.raises(EncodingError, match="where at most 1 are allowed"):
        decode_sequence(b"\0\0", limit=1)


@given(st.integers(0, 2**64 - 1))
def test_heads_of_integers(value: int) -> None:
    assert head(0x00, value) == encode(value)
    assert head(0x20, value) == encode(-1 - value)


@pytest.mark.parametrize("size", [0, 23, 24, 255, 256, 65535, 65536])
def test_heads_of_strings(size: int) -> None:
    assert encode(bytes(size)).startswith(head(0x40, size))
    assert len(encode(bytes(size))) == len(head(0x40, size)) + size


@pytest.mark.parametrize("value", [-1, 2**64])
def test_heads_have_a_range(value: int) -> None:
    with pytest.raises(EncodingError, match="integer beyond 64 bits"):
        head(0x40, value)


def test_parse_leaves_only_the_form_to_its_caller() -> None:
    assert parse(bytes.fromhex("1817")) == 23
    assert parse(bytes.fromhex("0000")) == 0
    for refused in ("", "c000", "a200010002", "9fff"):
        with pytest.raises(EncodingError, match="malformed CBOR"):
            parse(bytes.fromhex(refused))
