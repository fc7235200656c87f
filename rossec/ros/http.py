"""HTTP/1.1 for XML-RPC, sans-IO, both sides: the one shape that stock ROS clients and servers use.

POST, one `Content-length`, keep-alive. Never chunked: roscpp's XmlRpc++ cannot read it, and two
encodings of a length are ambiguous. Stricter than a general server may be (RFC 9112): no bare LF,
no folded line, no repeated length, so that no two readers of one stream can disagree about where a
request ends. Header and body limits are checked before a body byte is kept. Input is never
echoed back. A request with `Origin` comes from a web page in a browser of this host, without its
user's knowledge: refused. A general library costs 130 us a call here, more than the call itself;
the tests compare this module with one.
"""

import re
from functools import lru_cache
from typing import Final, NamedTuple

from rossec.errors import HttpRefused
from rossec.ros.httpread import END, Oversized, Reader
from rossec.ros.xmlrpc import BODY_LIMIT

_REASONS: Final = {
    400: b"Bad Request",
    403: b"Forbidden",
    405: b"Method Not Allowed",
    411: b"Length Required",
    413: b"Content Too Large",
    431: b"Request Header Fields Too Large",
}
COMPACT: Final = b"rossec-cbor/1"
"""What a connection may be switched to (RFC 9110 section 7.8): docs/spec/compact.md."""
_OFFER: Final = b"\r\nConnection: Upgrade\r\nUpgrade: " + COMPACT
_SWITCH: Final = b"HTTP/1.1 101 Switching Protocols" + _OFFER + b"\r\n\r\n"
_MAX_CACHED: Final = 512  # bytes of a head whose parsed form is cached
_TOKEN: Final = rb"[!#$%&'*+.^_`|~0-9A-Za-z-]+"
_REQUEST: Final = re.compile(rb"(%s) ([\x21-\x7e]+) HTTP/1\.([01])" % _TOKEN)
_RESPONSE: Final = re.compile(rb"HTTP/1\.([01]) ([1-5][0-9]{2})(?: [\t\x20-\x7e\x80-\xff]*)?")
_FIELD: Final = re.compile(rb"(%s):[ \t]*([\t\x20-\x7e\x80-\xff]*?)[ \t]*" % _TOKEN)
_LENGTH: Final = re.compile(rb"[0-9]{1,18}")
_ONCE: Final = (b"content-length", b"host", b"transfer-encoding")


class _Head(NamedTuple):
    """The part of a message before its body: the version and the fields."""

    minor: bytes
    fields: dict[bytes, bytes]

    @property
    def closes(self) -> bool:
        """Whether the connection ends after this exchange."""
        return self.minor == b"0" or b"close" in self._options

    @property
    def switches(self) -> bool:
        """Whether it offers, or takes, the compact form."""
        named = self.fields.get(b"upgrade") == COMPACT and b"upgrade" in self._options
        return named and self.minor == b"1"

    @property
    def _options(self) -> list[bytes]:
        options = self.fields.get(b"connection", b"").lower()
        return [option.strip() for option in options.split(b",")]


class HttpServer:
    """The server's side of one connection: `feed`, `next_request`, `respond`, again."""

    def __init__(self, *, limit: int = BODY_LIMIT) -> None:
        self._reader = Reader(limit)
        self._answering = False
        self._last = False  # the current request asks to close the connection
        self.is_offered = False
        """The current request offers the compact form: it may be answered with `switch`."""
        self.closing = False
        """No more requests are accepted on this connection (HTTP/1.0, close, an error)."""

    @property
    def pending(self) -> bool:
        """A request has begun and is not complete."""
        return self._reader.pending

    def feed(self, data: bytes) -> None:
        """Take bytes from the peer."""
        if self.closing:
            raise HttpRefused("HTTP bytes after the end of the connection")
        self._reader.feed(data)

    def feed_whole(self, data: bytes) -> bytes | Oversized | None:
        """`feed` and `next_request` in one: a fast path where `data` is one whole request.

        Raises:
            HttpRefused: as they do.
        """
        if not (self._answering or self.closing or self._reader.pending):
            end = data.find(END, 0, _MAX_CACHED)
            if end >= 0:
                begin, head = end + len(END), _cached_request_head(data[:end])
                if begin + head.length == len(data) and head.length <= self._reader.limit:
                    self._answering, self._last = True, head.closes
                    self.is_offered = head.offers
                    return data[begin:]
        self.feed(data)
        return self.next_request()

    def next_request(self) -> bytes | Oversized | None:
        """The body of the next complete request, or None while there is none.

        Raises:
            HttpRefused: answer with `refuse(error.status)`, then close.
        """
        if self._answering or self.closing:
            return None
        if not self._reader.in_body:
            head = self._reader.head()
            if head is None:
                return None
            self._begin(head)
        body = self._reader.body()
        self._answering = body is not None
        return body

    def respond(self, body: bytes) -> bytes:
        """The bytes of a `200 OK` with an XML body; afterwards the next request may be read."""
        self._answering = False
        self.closing = self._last
        return _message(b"HTTP/1.1 200 OK", body, close=self._last)

    def refuse(self, status: int) -> bytes:
        """The bytes of an error response, with its reason as text, that ends the connection."""
        if self.closing:
            return b""
        self.closing = True
        reason = _REASONS[status]
        return _message(b"HTTP/1.1 %d %s" % (status, reason), reason + b"\n", close=True)

    def _begin(self, data: bytes) -> None:
        head = _request_head(data) if len(data) > _MAX_CACHED else _cached_request_head(data)
        if head.length > self._reader.limit:
            self._reader.drop(data, head.length)
        else:
            self._reader.expect(data, head.length)
        self._last = head.closes
        self.is_offered = head.offers

    def switch(self) -> bytes:
        """The head that takes the offer; nothing else of HTTP follows on this connection."""
        return _SWITCH


class _RequestHead(NamedTuple):
    """The parsed head of a request."""

    length: int
    closes: bool
    offers: bool


def _request_head(data: bytes) -> _RequestHead:
    line, _, rest = data.partition(b"\r\n")
    request = _REQUEST.fullmatch(line)
    if request is None:
        raise HttpRefused("malformed HTTP")
    if request[1] != b"POST":
        raise HttpRefused("an HTTP request that is not POST", status=405)
    head = _Head(request[3], _fields(rest))
    if head.minor == b"1" and b"host" not in head.fields:
        raise HttpRefused("malformed HTTP")
    if b"origin" in head.fields:
        raise HttpRefused("an HTTP request from a web page", status=403)
    offers = head.switches and not head.closes
    return _RequestHead(_length(head.fields), head.closes, offers)


_cached_request_head = lru_cache(256)(_request_head)
"""The heads of one client are always the same bytes; refusals are not cached."""


class HttpClient:
    """The client's side of one connection: `request`, `feed`, `next_response`, again."""

    def __init__(self, host: str, *, path: str = "/", limit: int = BODY_LIMIT) -> None:
        self._reader = Reader(limit)
        self._first = f"POST {path} HTTP/1.1\r\nHost: {host}".encode("ascii")
        self._offers = False
        self.switched: bytes | None = None
        """What follows the head by which the server took the offer; None: it did not."""
        self._waiting = False
        self._last = False

    @property
    def closing(self) -> bool:
        """The server will not answer another request on this connection."""
        return self._waiting or self._last

    def request(self, body: bytes, *, offers: bool = False) -> bytes:
        """The bytes of one POST request; `offers` the compact form from the answer on."""
        self._waiting, self._offers = True, offers
        first = self._first + _OFFER if offers else self._first
        return _message(first, body, close=False)

    def feed(self, data: bytes) -> None:
        """Take bytes from the peer."""
        self._reader.feed(data)

    def take_back(self) -> None:
        """The last request is not sent."""
        self._waiting = self._offers = False

    def next_response(self) -> bytes | None:
        """The body of the response, or None while it is not complete.

        Raises:
            HttpRefused: malformed, too long, or a status other than 200.
        """
        while not self._reader.in_body:
            data = self._reader.head()
            if data is None or self.switched is not None:
                return None
            self._begin(data)
        body = self._reader.body()
        if isinstance(body, Oversized):
            raise HttpRefused("an HTTP response that is too long")
        self._waiting = body is None
        return body

    def _begin(self, data: bytes) -> None:
        line, _, rest = data.partition(b"\r\n")
        response = _RESPONSE.fullmatch(line)
        if response is None:
            raise HttpRefused("malformed HTTP")
        fields = _fields(rest)
        if response[2] == b"101":
            if not (self._offers and _Head(response[1], fields).switches):
                raise HttpRefused("HTTP that switches to a protocol that was not offered")
            self.switched = self._reader.rest(len(data) + len(END))
            return
        if response[2].startswith(b"1"):  # an interim response: the real one follows
            self._reader.skip(len(data) + len(END))
            return
        if response[2] != b"200":
            status = int(response[2])
            raise HttpRefused(f"HTTP status {status}", status=status)
        self._reader.expect(data, _length(fields))
        self._last = _Head(response[1], fields).closes


def _fields(data: bytes) -> dict[bytes, bytes]:
    fields: dict[bytes, bytes] = {}
    for line in data.split(b"\r\n") if data else ():
        match = _FIELD.fullmatch(line)
        if match is None:
            raise HttpRefused("malformed HTTP")
        name = match[1].lower()
        if name not in fields:
            fields[name] = match[2]
        elif name in _ONCE:
            raise HttpRefused("malformed HTTP")
        else:
            fields[name] += b", " + match[2]
    return fields


def _length(fields: dict[bytes, bytes]) -> int:
    length = fields.get(b"content-length")
    if length is None or b"transfer-encoding" in fields:
        raise HttpRefused("HTTP without a Content-length", status=411)
    if _LENGTH.fullmatch(length) is None:
        raise HttpRefused("malformed HTTP")
    return int(length)


def _message(first: bytes, body: bytes, *, close: bool) -> bytes:
    end = b"\r\nConnection: close" if close else b""
    return b"%s\r\nContent-Type: text/xml\r\nContent-length: %d%s\r\n\r\n%s" % (
        first, len(body), end, body,
    )  # fmt: skip
