"""HTTP framing for XML-RPC: both sides against each other, three ways of feeding, every refusal."""

import h11
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.errors import HttpRefused
from rossec.ros.http import HttpClient, HttpServer

REQUEST = b"POST /RPC2 HTTP/1.1\r\nHost: x\r\nContent-Length: 4\r\n\r\nbody"


def test_both_sides_over_one_connection() -> None:
    client, server = HttpClient("host:1"), HttpServer()
    for body in (b"first", b"", b"x" * 100_000):
        server.feed(client.request(body))
        assert server.next_request() == body
        assert server.next_request() is None
        client.feed(server.respond(body + b"!"))
        assert client.next_response() == body + b"!"
        assert not client.closing
        assert not server.closing


def test_response_is_what_roscpp_reads() -> None:
    server = HttpServer()
    server.feed(REQUEST)
    server.next_request()
    response = server.respond(b"<x/>")
    assert response.startswith(b"HTTP/1.1 200 OK\r\n")
    assert b"\r\nContent-length: 4\r\n" in response
    assert b"chunked" not in response
    assert response.endswith(b"\r\n\r\n<x/>")


def test_request_byte_by_byte() -> None:
    server = HttpServer()
    bodies: list[bytes] = []
    for byte in REQUEST:
        assert not bodies
        server.feed(bytes([byte]))
        body = server.next_request()
        if isinstance(body, bytes):
            bodies.append(body)
    assert bodies == [b"body"]


def test_response_byte_by_byte() -> None:
    client, server = HttpClient("h"), HttpServer()
    server.feed(client.request(b""))
    server.next_request()
    response = server.respond(b"answer")
    for byte in response[:-1]:
        client.feed(bytes([byte]))
        assert client.next_response() is None
    client.feed(response[-1:])
    assert client.next_response() == b"answer"


def test_a_tail_is_the_next_request() -> None:
    server = HttpServer()
    server.feed(REQUEST + REQUEST[:30])
    assert server.next_request() == b"body"
    assert server.next_request() is None  # not before the first is answered
    server.respond(b"")
    assert server.pending
    server.feed(REQUEST[30:])
    assert server.next_request() == b"body"
    assert not server.pending


def test_http_10_closes_after_the_answer() -> None:
    server = HttpServer()
    server.feed(REQUEST.replace(b"HTTP/1.1", b"HTTP/1.0"))
    server.next_request()
    assert b"onnection: close" in server.respond(b"")
    assert server.closing


def test_a_client_notices_that_the_server_closes() -> None:
    client = HttpClient("h")
    client.request(b"")
    client.feed(b"HTTP/1.1 200 OK\r\nConnection: close\r\nContent-Length: 1\r\n\r\nx")
    assert client.next_response() == b"x"
    assert client.closing


def test_continue_is_skipped() -> None:
    client = HttpClient("h")
    client.request(b"")
    client.feed(b"HTTP/1.1 100 Continue\r\n\r\nHTTP/1.1 200 OK\r\nContent-Length: 1\r\n\r\nx")
    assert client.next_response() == b"x"


@pytest.mark.parametrize(
    ("request_bytes", "status"),
    [
        (b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", 405),
        (b"POST / HTTP/1.1\r\nHost: x\r\nOrigin: null\r\nContent-Length: 0\r\n\r\n", 403),
        (b"POST / HTTP/1.1\r\nHost: x\r\n\r\n", 411),
        (b"POST / HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\n", 411),
        (b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 67108865\r\n\r\n", 413),
        (b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: " + b"9" * 18 + b"\r\n\r\n", 413),
        (b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: -1\r\n\r\n", 400),
        (b"POST / HTTP/1.1\r\nHost: x\r\nA: " + b"a" * 9000 + b"\r\nContent-Length: 0\r\n\r\n", 431),
        (b"POST / HTTP/1.1\r\nHost: x\r\nA: " + b"a" * 9000, 431),
        (b"POST / HTTP/1.1\r\nContent-Length: 0\r\n\r\n", 400),
        (b"POST / HTTP/1.1\r\nHost: x\r\nHost: y\r\nContent-Length: 0\r\n\r\n", 400),
        (b"POST / HTTP/1.1\r\nHost: x\r\n" + 2 * b"Content-Length: 1\r\n" + b"\r\nx", 400),
        (b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 1, 1\r\n\r\nx", 400),
        (b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: +1\r\n\r\nx", 400),
        (b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length : 1\r\n\r\nx", 400),
        (b"POST / HTTP/1.1\r\nHost: x\r\nA: b\r\n c\r\nContent-Length: 1\r\n\r\nx", 400),
        (b"POST / HTTP/1.1\r\nHost: x\nContent-Length: 1\r\n\r\nx", 400),
        (b"POST / HTTP/1.1\r\nHost: x\0\r\nContent-Length: 1\r\n\r\nx", 400),
        (b"POST / HTTP/2.0\r\nHost: x\r\nContent-Length: 1\r\n\r\nx", 400),
        (b"POST  / HTTP/1.1\r\nHost: x\r\nContent-Length: 1\r\n\r\nx", 400),
        (b"\r\nPOST / HTTP/1.1\r\nHost: x\r\nContent-Length: 1\r\n\r\nx", 400),
        (b"\x16\x03\x01garbage\r\n\r\n", 400),
    ],
)
def test_server_refuses(request_bytes: bytes, status: int) -> None:
    server, other = HttpServer(limit=100), HttpServer(limit=100)
    server.feed(request_bytes)
    with pytest.raises(HttpRefused) as refused:
        server.next_request()
    with pytest.raises(HttpRefused) as also:
        other.feed_whole(request_bytes)
    assert refused.value.status == also.value.status == status
    answer = server.refuse(status)
    assert answer.startswith(b"HTTP/1.1 %d " % status)
    assert b"garbage" not in answer
    assert server.closing
    assert server.refuse(status) == b""


PIECES = [
    b"POST",
    b"GET",
    b" ",
    b"/",
    b"HTTP/1.1",
    b"HTTP/1.0",
    b"\r\n",
    b"\n",
    b"\r",
    b"\r\n\r\n",
    b"Host: x",
    b"Content-Length: 2",
    b"content-length:\t3 ",
    b"Connection: a, close",
    b"Transfer-Encoding: chunked",
    b"X:",
    b"\xff",
    b"\0",
    b"body",
]
LINES = [piece + b"\r\n" for piece in PIECES]


@pytest.mark.parametrize("end", [b"\r\n\r\n", b"\r\nConnection: close\r\n\r\n"])
@pytest.mark.parametrize("size", [4, 101])
def test_the_fast_path_gives_the_same_result(end: bytes, size: int) -> None:
    whole = b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: %d" % size + end + b"b" * size
    for parts in ([whole], [whole[:9], whole[9:]], [whole[:-1], whole[-1:]], [whole + whole]):
        found = []
        for short in (False, True):
            server = HttpServer(limit=100)
            try:
                *before, last = parts
                for part in before:
                    server.feed(part)
                    assert server.next_request() is None
                if short:
                    body = server.feed_whole(last)
                else:
                    server.feed(last)
                    body = server.next_request()
                found.append((body, server.respond(b"x"), server.pending, server.closing))
            except HttpRefused as error:
                found.append((None, server.refuse(error.status), True, True))
        assert found[0] == found[1]
        assert (found[0][0] == b"b" * size) is (size == 4)


def test_the_fast_path_waits_for_the_answer_and_ends_with_the_connection() -> None:
    server = HttpServer()
    assert server.feed_whole(REQUEST) == b"body"
    assert server.feed_whole(REQUEST) is None
    server.respond(b"")
    assert server.next_request() == b"body"
    server.refuse(400)
    with pytest.raises(HttpRefused):
        server.feed_whole(REQUEST)


@given(st.lists(st.sampled_from([*PIECES, *LINES])).map(b"".join) | st.binary(max_size=40))
def test_what_is_accepted_is_what_a_general_library_reads(tail: bytes) -> None:
    """Two readers of one stream must not disagree about where a request ends."""
    for data in (tail, b"POST / HTTP/1.1\r\nHost: x\r\n" + tail):
        server = HttpServer()
        server.feed(data)
        try:
            body = server.next_request()
        except HttpRefused:
            continue
        if body is None:
            continue
        assert HttpServer().feed_whole(data) == body
        oracle = h11.Connection(h11.SERVER)
        oracle.receive_data(data)
        assert isinstance(oracle.next_event(), h11.Request)
        event, read = oracle.next_event(), b""
        while isinstance(event, h11.Data):
            read += event.data
            event = oracle.next_event()
        assert isinstance(event, h11.EndOfMessage)
        assert read == body
        server.respond(b"")
        assert server.closing == (oracle.our_state is h11.MUST_CLOSE or oracle.their_state is h11.MUST_CLOSE)


def test_bytes_after_the_end_are_refused() -> None:
    server = HttpServer()
    server.feed(REQUEST.replace(b"Host: x", b"Host: x\r\nConnection: a\r\nConnection: Close"))
    assert server.next_request() == b"body"
    server.respond(b"")
    assert server.next_request() is None
    with pytest.raises(HttpRefused, match="after the end"):
        server.feed(b"P")


@pytest.mark.parametrize(
    ("response", "message"),
    [
        (b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n", "404"),
        (b"HTTP/1.1 200 OK\r\n\r\n", "Content-length"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 101\r\n\r\n", "longer than 100"),
        (b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n", "Content-length"),
        (b"\x00\x01\x02\x03", "malformed"),
    ],
)
def test_client_refuses(response: bytes, message: str) -> None:
    client = HttpClient("h", limit=100)
    client.request(b"")
    client.feed(response)
    with pytest.raises(HttpRefused, match=message):
        client.next_response()
    assert client.closing
