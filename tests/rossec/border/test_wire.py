"""CoAP messages as bytes: whatever is wrong with them is one refusal."""

import contextlib

import aiocoap
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.border import messages
from rossec.errors import DatagramRefused


def get(kind: object = messages.CON, mid: int = 5) -> aiocoap.Message:
    message = aiocoap.Message(code=aiocoap.GET, uri_path=("t",))
    message.mtype, message.mid, message.token = kind, mid, b"ab"
    return message


def test_a_message_is_written_and_read() -> None:
    data = messages.write(get())
    assert data == b"B\x01\x00\x05ab\xb1t"
    found = messages.read(data)
    assert (found.code, found.mtype, found.token) == (aiocoap.GET, messages.CON, b"ab")
    assert (found.opt.uri_path, messages.number_of(found), messages.is_empty(found)) == (("t",), 5, False)


@given(st.binary(max_size=64))
def test_any_bytes_are_a_message_or_refused(data: bytes) -> None:
    with contextlib.suppress(DatagramRefused):
        messages.read(data)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x40\x00\x00",
        bytes(messages.MAX_DATAGRAM + 1),
        b"\x49\x01\x00\x05" + bytes(9),  # a token of 9 octets
        b"\x40\x00\x00\x05\x00",  # an empty message with more
        b"\x80\x01\x00\x05",  # another version
    ],
)
def test_malformed_datagrams_are_refused(data: bytes) -> None:
    with pytest.raises(DatagramRefused):
        messages.read(data)


def test_empty_messages() -> None:
    found = messages.read(messages.empty(messages.RST, 0x0102))
    assert messages.is_empty(found)
    assert (found.mtype, messages.number_of(found)) == (messages.RST, 0x0102)


@pytest.mark.parametrize(
    ("asked", "kind", "mid"), [(messages.CON, messages.ACK, 5), (messages.NON, messages.NON, 99)]
)
def test_an_answer_is_piggybacked_where_it_can_be(asked: object, kind: object, mid: int) -> None:
    found = messages.answer(get(asked), aiocoap.Message(code=aiocoap.UNAUTHORIZED), 99)
    assert (found.token, found.mtype, found.mid) == (b"ab", kind, mid)
    assert messages.read(messages.write(found)).code == aiocoap.UNAUTHORIZED
