import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.encoding import Value, encode
from rossec.channel.edhoc.messages import (
    MAX_MESSAGE_1,
    MAX_REASON,
    Message1,
    Plaintext,
    decode_bytes,
    decode_error,
    decode_message_1,
    decode_plaintext,
    decode_plaintext_4,
    encode_error,
    encode_identifier,
    printable,
)
from rossec.errors import HandshakeFailed

G = bytes(range(32))


def sequence(*items: Value) -> bytes:
    return b"".join(map(encode, items))


@pytest.mark.parametrize("c_i", [b"", b"\x00", b"\x17", b"\x20", b"\x37", b"\x18", b"\x38", b"ab"])
@pytest.mark.parametrize("suites", [(6,), (4, 6), (0, 4, 6)])
def test_message_1_there_and_back(suites: tuple[int, ...], c_i: bytes) -> None:
    message = Message1(0, suites, G, c_i)
    data = message.encode()
    assert decode_message_1(data) == message
    assert decode_message_1(data + sequence(40, b"value", 0)) == message
    for count in range(len(data)):
        with pytest.raises(HandshakeFailed):
            decode_message_1(data[:count])


@pytest.mark.parametrize(
    "items",
    [
        (),
        (0, 6, G),
        (True, 6, G, b""),
        (0, [6], G, b""),
        (0, [], G, b""),
        (0, ["six", 6], G, b""),
        (0, [True, 6], G, b""),
        (0, list(range(17)), G, b""),
        (0, "six", G, b""),
        (0, 6, "text", b""),
        (0, 6, G, 24),
        (0, 6, G, -25),
        (0, 6, G, True),
        (0, 6, G, "text"),
        (0, 6, G, b"\x00"),  # must be the integer
        (0, 6, G, b"", b"value without label"),
        (0, 6, G, b"", 1, b"value", b"another"),
        (0, 6, G, b"", True),
        (0, 6, G, b"", -1),
        (0, 6, G, b"x" * MAX_MESSAGE_1),
    ],
)
def test_a_malformed_message_1(items: tuple[Value, ...]) -> None:
    with pytest.raises(HandshakeFailed):
        decode_message_1(sequence(*items))


def test_one_byte_string_and_nothing_else() -> None:
    assert decode_bytes(encode(G)) == G
    for data in (b"", encode(G) * 2, encode(1), b"\x59\x00\x01x", encode(G)[:-1]):
        with pytest.raises(HandshakeFailed):
            decode_bytes(data)


@pytest.mark.parametrize("c_r", [None, b"\x01", b"", b"ab"])
def test_plaintexts_there_and_back(c_r: bytes | None) -> None:
    plain = Plaintext(c_r, {33: b"certificate"}, bytes(64), sequence(7, b"value"))
    assert decode_plaintext(plain.encode(), with_c_r=c_r is not None) == plain


@pytest.mark.parametrize(
    "items",
    [
        (),
        (1,),
        (1, {33: b"c"}),
        (1, {33: b"c"}, bytes(63)),
        (1, {33: b"c"}, bytes(65)),
        (1, {33: b"c"}, bytes(64), -7),
        (1, b"kid", bytes(64)),
        (1, 5, bytes(64)),
    ],
)
def test_a_malformed_plaintext(items: tuple[Value, ...]) -> None:
    with pytest.raises(HandshakeFailed):
        decode_plaintext(sequence(*items), with_c_r=True)


def test_plaintext_4_is_at_most_an_extension() -> None:
    decode_plaintext_4(b"")
    decode_plaintext_4(sequence(9, b"x"))
    for data in (sequence(-9), sequence("x"), b"\xff"):
        with pytest.raises(HandshakeFailed):
            decode_plaintext_4(data)


@pytest.mark.parametrize(
    ("data", "meaning"),
    [
        (encode_error(1, "go\naway"), (1, "go away", ())),
        (encode_error(2, 6), (2, "no common cipher suite", (6,))),
        (encode_error(2, [4, 6]), (2, "no common cipher suite", (4, 6))),
    ],
)
def test_errors_there_and_back(data: bytes, meaning: tuple[int, str, tuple[int, ...]]) -> None:
    assert decode_error(data) == meaning


def test_error_3_names_its_cause() -> None:
    assert "does not know the credential" in decode_error(encode_error(3, True))[1]


@pytest.mark.parametrize("data", [b"", sequence(0, "ok"), sequence(1, 1), sequence(1), b"\x01" * 9])
def test_a_malformed_error(data: bytes) -> None:
    with pytest.raises(HandshakeFailed):
        decode_error(data)


def test_an_unauthenticated_text_is_made_printable() -> None:
    assert printable("a\r\nb\x00\x1b[2Jc") == "a b [2Jc"
    assert len(printable("x" * 10_000)) == MAX_REASON


def test_identifiers() -> None:
    assert encode_identifier(b"\x0e") == b"\x0e"
    assert encode_identifier(b"\x18") == b"\x41\x18"


@given(st.binary(max_size=200))
def test_decoders_raise_only_our_error(data: bytes) -> None:
    for decode in (decode_message_1, decode_bytes, decode_error, decode_plaintext_4):
        with contextlib.suppress(HandshakeFailed):
            decode(data)
    with contextlib.suppress(HandshakeFailed):
        decode_plaintext(data, with_c_r=True)
