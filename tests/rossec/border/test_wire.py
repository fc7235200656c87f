"""CoAP messages as bytes: whatever is wrong with them is one refusal."""

import contextlib

import aiocoap
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.border import wire
from rossec.errors import DatagramRefused


def get(kind: object = wire.CON, mid: int = 5) -> aiocoap.Message:
    message = aiocoap.Message(code=aiocoap.GET, uri_path=("t",))
    message.mtype, message.mid, message.token = kind, mid, b"ab"
    return message


def test_a_message_is_written_and_read() -> None:
    data = wire.write(get())
    assert data == b"B\x01\x00\x05ab\xb1t"
    found = wire.read(data)
    assert (found.code, found.mtype, found.token) == (aiocoap.GET, wire.CON, b"ab")
    assert (found.opt.uri_path, wire.number_of(found), wire.is_empty(found)) == (("t",), 5, False)


@given(st.binary(max_size=64))
def test_any_bytes_are_a_message_or_refused(data: bytes) -> None:
    with contextlib.suppress(DatagramRefused):
        wire.read(data)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x40\x00\x00",
        bytes(wire.MAX_DATAGRAM + 1),
        b"\x49\x01\x00\x05" + bytes(9),  # a token of 9 octets
        b"\x40\x00\x00\x05\x00",  # an empty message with more
        b"\x80\x01\x00\x05",  # another version
    ],
)
def test_malformed_datagrams_are_refused(data: bytes) -> None:
    with pytest.raises(DatagramRefused):
        wire.read(data)


def test_empty_messages() -> None:
    found = wire.read(wire.empty(wire.RST, 0x0102))
    assert wire.is_empty(found)
    assert (found.mtype, wire.number_of(found)) == (wire.RST, 0x0102)


@pytest.mark.parametrize(
    ("asked", "kind", "mid"), [(wire.CON, wire.ACK, 5), (wire.NON, wire.NON, 99)]
)
def test_an_answer_is_piggybacked_where_it_can_be(asked: object, kind: object, mid: int) -> None:
    found = wire.answer(get(asked), wire.refusal(aiocoap.UNAUTHORIZED), 99)
    assert (found.token, found.mtype, found.mid) == (b"ab", kind, mid)
    assert wire.read(wire.write(found)).code == aiocoap.UNAUTHORIZED
