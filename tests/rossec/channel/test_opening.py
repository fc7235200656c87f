import xml.etree.ElementTree as ET
from xmlrpc.client import loads

import pytest

from rossec.channel.opening import (
    MAX_DRAIN,
    MAX_OPENING,
    REFUSAL,
    Accepted,
    PlainCaller,
    WireProtocol,
    classify_answer,
    classify_caller,
    first_bytes,
    http_refusal,
    refusal,
    tcpros_refusal,
)
from rossec.errors import PlainPeer, ProtocolViolation

SWITCH = b"HTTP/1.1 101 Switching Protocols\r\nConnection: Upgrade\r\nUpgrade: rossec/1\r\n\r\n"


def test_the_bytes_of_the_tcpros_opening() -> None:
    assert first_bytes(WireProtocol.TCPROS) == b"\x0c\0\0\0\x08\0\0\0rossec=1"


@pytest.mark.parametrize("protocol", list(WireProtocol))
@pytest.mark.parametrize("tail", [b"", b"\x10\0\0\x05"])
def test_our_own_opening_byte_by_byte_and_with_a_tail(protocol: WireProtocol, tail: bytes) -> None:
    opening = first_bytes(protocol)
    for count in range(len(opening)):
        assert classify_caller(opening[:count]) is None
    verdict = classify_caller(opening + tail)
    assert isinstance(verdict, Accepted)
    assert verdict.protocol is protocol
    assert verdict.consumed == len(opening)
    assert verdict.reply == (SWITCH if protocol is WireProtocol.HTTP else b"")


@pytest.mark.parametrize(
    ("data", "drain"),
    [
        (b"\x0c\0\0\0\x08\0\0\0rossec=2", 16),
        (b"\x05\0\0\0", 9),
        (b"\0\0\x01\0", 4 + 65536),
        (MAX_DRAIN.to_bytes(4, "little"), 4 + MAX_DRAIN),
    ],
)
def test_a_plain_tcpros_header(data: bytes, drain: int) -> None:
    assert classify_caller(data) == PlainCaller(WireProtocol.TCPROS, drain)


@pytest.mark.parametrize(
    "data",
    [
        bytes(4),
        b"\x04\0\0\0",
        (MAX_DRAIN + 1).to_bytes(4, "little"),
        b"\xff\xff\xff\x3b",  # N7: close to 1 GB
        b"\x16\x03\x01\x02",  # TLS
        b"SSH-2.0-",
        b"POST " + b"x" * MAX_OPENING,
        b"POST / HTTP/1.1\r\nno colon\r\n\r\n",
        b"POST / HTTP/1.1\r\nA: 1\r\nA: 2\r\n\r\n",
    ],
)
def test_garbage_gets_no_answer(data: bytes) -> None:
    with pytest.raises(ProtocolViolation):
        classify_caller(data)


@pytest.mark.parametrize(
    ("head", "body"),
    [
        (b"POST /RPC2 HTTP/1.1\r\nContent-length: 17\r\n\r\n", 17),
        (b"POST / HTTP/1.0\r\n\r\n", 0),
        (b"GET /rossec HTTP/1.1\r\nUpgrade: websocket\r\n\r\n", 0),
        (b"GET /rossec HTTP/1.0\r\nUpgrade: rossec/1\r\n\r\n", 0),
        (b"POST / HTTP/1.1\r\nContent-Length: 999999999\r\n\r\n", MAX_DRAIN),
        (b"POST / HTTP/1.1\r\nContent-Length: 9999999999\r\n\r\n", 0),
        (b"POST / HTTP/1.1\r\nContent-Length: -1\r\n\r\n", 0),
    ],
)
def test_plain_http(head: bytes, body: int) -> None:
    assert classify_caller(head[:-1]) is None
    assert classify_caller(head + b"tail") == PlainCaller(WireProtocol.HTTP, len(head) + body)


def test_the_refusals_are_valid_in_their_own_protocol() -> None:
    tcpros = refusal(WireProtocol.TCPROS)
    assert int.from_bytes(tcpros[:4], "little") == len(tcpros) - 4
    assert int.from_bytes(tcpros[4:8], "little") == len(tcpros) - 8
    assert tcpros[8:].decode() == f"error={REFUSAL}"
    head, body = refusal(WireProtocol.HTTP).split(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 200 OK\r\n")
    assert f"Content-length: {len(body)}".encode() in head.split(b"\r\n")
    assert loads(body)[0] == ([-1, REFUSAL, 0],)
    ET.fromstring(http_refusal("a < b & c").split(b"\r\n\r\n")[1])


# -- what the peer answers


def test_a_frame_is_not_a_preamble() -> None:
    assert classify_answer(b"\x10\0\0", WireProtocol.TCPROS) is None
    assert classify_answer(b"\x10\0\x02\0", WireProtocol.TCPROS) == 0
    assert classify_answer(b"\x20\0\0\x05", WireProtocol.TCPROS) == 0


def test_the_switch_of_protocols() -> None:
    for count in range(len(SWITCH)):
        assert classify_answer(SWITCH[:count], WireProtocol.HTTP) is None
    assert classify_answer(SWITCH + b"\x10", WireProtocol.HTTP) == len(SWITCH)


@pytest.mark.parametrize(
    ("answer", "protocol", "said"),
    [
        (tcpros_refusal("no topic"), WireProtocol.TCPROS, "says: no topic"),
        (tcpros_refusal("a\nb\x1b[31m" + "x" * 500), WireProtocol.TCPROS, r"says: a b \[31mx+$"),
        (b"\x09\0\0\0\x05\0\0\0a=b=c", WireProtocol.TCPROS, "answers without an error"),
        (b"\xff\xff\0\0" + b"x" * MAX_OPENING, WireProtocol.TCPROS, "answers without an error"),
        (b"HTTP/1.1 501 Unsupported method\r\n\r\n", WireProtocol.HTTP, "HTTP/1.1 501 Unsupported"),
        (b"HTTP/1.1 400 Bad\r\n\r\n", WireProtocol.TCPROS, "HTTP/1.1 400 Bad"),
        (SWITCH, WireProtocol.TCPROS, "101"),
        (b"HTTP" + b"x" * MAX_OPENING, WireProtocol.HTTP, "HTTPx+$"),
        (b"\x10\0\x02\0", WireProtocol.HTTP, "does not answer in HTTP"),
    ],
)
def test_a_plain_peer_is_quoted(answer: bytes, protocol: WireProtocol, said: str) -> None:
    with pytest.raises(PlainPeer, match=said) as caught:
        classify_answer(answer, protocol)
    assert len(str(caught.value)) < 300
    assert "plain ROS node" in caught.value.hint


def test_a_plain_answer_that_is_still_coming() -> None:
    assert classify_answer(tcpros_refusal("no topic")[:-1], WireProtocol.TCPROS) is None
