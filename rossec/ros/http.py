"""HTTP/1.1 for XML-RPC, sans-IO, both sides: h11 frames, this module narrows.

Only what stock ROS clients and servers do: POST, `Content-length`, `text/xml`, keep-alive. Never
chunked: roscpp's XmlRpc++ cannot read it, and two ways to say a length are one too many. Header
and body limits are checked before a body byte is kept. What a peer sent is never echoed back.
"""

from typing import Final

import h11

from rossec.errors import HttpRefused
from rossec.ros.xmlrpc import BODY_LIMIT

HEADERS_LIMIT: Final = 8 * 1024
_REASONS: Final = {
    400: b"Bad Request",
    405: b"Method Not Allowed",
    411: b"Length Required",
    413: b"Content Too Large",
    431: b"Request Header Fields Too Large",
}


class HttpServer:
    """The server's side of one connection: `feed`, `next_request`, `respond`, again."""

    def __init__(self, *, limit: int = BODY_LIMIT) -> None:
        self._side = _Side(h11.SERVER, limit)

    @property
    def closing(self) -> bool:
        """Nothing more can be asked on this connection (HTTP/1.0, close, an error)."""
        return self._side.connection.our_state in (h11.MUST_CLOSE, h11.CLOSED, h11.ERROR)

    @property
    def pending(self) -> bool:
        """A request has begun and is not complete."""
        return self._side.pending

    def feed(self, data: bytes) -> None:
        """Take bytes from the peer."""
        self._side.feed(data)

    def next_request(self) -> bytes | None:
        """The body of the next complete request, or None while there is none.

        Raises:
            HttpRefused: answer with `refuse(error.status)`, then close.
        """
        return self._side.next_body()

    def respond(self, body: bytes) -> bytes:
        """The bytes of a `200 OK` with an XML body; afterwards the next request may be read."""
        return self._answer(200, b"OK", body, [])

    def refuse(self, status: int) -> bytes:
        """The bytes of an empty error response that ends the connection."""
        if self._side.connection.our_state not in (h11.IDLE, h11.SEND_RESPONSE):
            return b""
        return self._answer(status, _REASONS[status], b"", [("Connection", "close")])

    def _answer(
        self, status: int, reason: bytes, body: bytes, extra: list[tuple[str, str]]
    ) -> bytes:
        headers = [("Content-Type", "text/xml"), ("Content-length", str(len(body))), *extra]
        return self._side.message(
            h11.Response(status_code=status, reason=reason, headers=headers), body
        )


class HttpClient:
    """The client's side of one connection: `request`, `feed`, `next_response`, again."""

    def __init__(self, host: str, *, path: str = "/", limit: int = BODY_LIMIT) -> None:
        self._side = _Side(h11.CLIENT, limit)
        self._host = host
        self._path = path

    @property
    def closing(self) -> bool:
        """The server will not answer another request on this connection."""
        return self._side.connection.our_state is not h11.IDLE

    def request(self, body: bytes) -> bytes:
        """The bytes of one POST request."""
        headers = [
            ("Host", self._host),
            ("Content-Type", "text/xml"),
            ("Content-length", str(len(body))),
        ]
        return self._side.message(
            h11.Request(method="POST", target=self._path, headers=headers), body
        )

    def feed(self, data: bytes) -> None:
        """Take bytes from the peer."""
        self._side.feed(data)

    def next_response(self) -> bytes | None:
        """The body of the response, or None while it is not complete.

        Raises:
            HttpRefused: malformed, too long, or a status other than 200.
        """
        body = self._side.next_body()
        if body is not None:
            self._side.finish_cycle()
        return body


class _Side:
    """What both sides share: one h11 connection, one body being collected."""

    def __init__(self, role: type[h11.CLIENT] | type[h11.SERVER], limit: int) -> None:
        self.connection = h11.Connection(role, max_incomplete_event_size=HEADERS_LIMIT)
        self._limit = limit
        self._body = bytearray()
        self._begun = False

    @property
    def pending(self) -> bool:
        return self._begun or bool(self.connection.trailing_data[0])

    def feed(self, data: bytes) -> None:
        if data:  # h11 takes an empty string as the end of the stream
            try:
                self.connection.receive_data(data)
            except RuntimeError as error:
                raise HttpRefused("HTTP bytes after the end of the connection") from error

    def next_body(self) -> bytes | None:
        while True:
            event = self._next_event()
            match event:
                case h11.Request() | h11.Response():
                    self._begun = True
                    _check_head(event, self._limit)
                case h11.Data():
                    self._body += event.data
                case h11.EndOfMessage():
                    self._begun = False
                    body, self._body = bytes(self._body), bytearray()
                    return body
                case h11.InformationalResponse():
                    continue
                case _:  # need more, paused until we answered, or closed
                    return None

    def message(self, head: h11.Request | h11.Response, body: bytes) -> bytes:
        parts = [self.connection.send(head)]
        if body:
            parts.append(self.connection.send(h11.Data(data=body)))
        parts.append(self.connection.send(h11.EndOfMessage()))
        if isinstance(head, h11.Response):
            self.finish_cycle()
        return b"".join(parts)

    def finish_cycle(self) -> None:
        states = self.connection.states
        if set(states.values()) == {h11.DONE}:
            self.connection.start_next_cycle()

    def _next_event(self) -> object:
        try:
            return self.connection.next_event()
        except h11.RemoteProtocolError as error:
            raise HttpRefused("malformed HTTP") from error


def _check_head(head: h11.Request | h11.Response, limit: int) -> None:
    if isinstance(head, h11.Request) and head.method != b"POST":
        raise HttpRefused("an HTTP request that is not POST", status=405)
    if isinstance(head, h11.Response) and head.status_code != 200:
        raise HttpRefused(f"HTTP status {head.status_code}", status=head.status_code)
    if sum(len(name) + len(value) for name, value in head.headers) > HEADERS_LIMIT:
        raise HttpRefused("HTTP headers that are too long", status=431)
    fields = dict(head.headers)
    length = fields.get(b"content-length")
    if length is None or b"transfer-encoding" in fields:
        raise HttpRefused("HTTP without a Content-length", status=411)
    if int(length) > limit:
        raise HttpRefused(f"an HTTP body longer than {limit} bytes", status=413)
