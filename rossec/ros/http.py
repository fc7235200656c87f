"""HTTP/1.1 for XML-RPC, sans-IO, both sides: the one shape that stock ROS clients and servers use.

POST, one `Content-length`, keep-alive. Never chunked: roscpp's XmlRpc++ cannot read it, and two
encodings of a length are ambiguous. Stricter than a general server may be (RFC 9112): no bare LF,
no folded line, no repeated length, so that no two readers of one stream can disagree about where a
request ends. Header and body limits are checked before a body byte is kept. Input is never echoed
back. A general library costs 130 us a call here, more than the call itself; the tests compare this
module with one.
"""

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

from rossec.errors import HttpRefused
from rossec.ros.xmlrpc import BODY_LIMIT

HEADERS_LIMIT: Final = 8 * 1024
# Bytes of a body that are read although it is too long, only to answer so
DROP_LIMIT: Final = 64 * 1024 * 1024
END: Final = b"\r\n\r\n"
_REASONS: Final = {
    400: b"Bad Request",
    403: b"Forbidden",
    405: b"Method Not Allowed",
    411: b"Length Required",
    413: b"Content Too Large",
    431: b"Request Header Fields Too Large",
}
# What a connection may be switched to (RFC 9110 section 7.8): docs/spec/compact.md
COMPACT: Final = b"rossec-cbor/1"
_OFFER: Final = b"\r\nConnection: Upgrade\r\nUpgrade: " + COMPACT
SWITCH: Final = b"HTTP/1.1 101 Switching Protocols" + _OFFER + b"\r\n\r\n"
_MAX_CACHED: Final = 512  # bytes of a head whose parsed form is cached
_TOKEN: Final = rb"[!#$%&'*+.^_`|~0-9A-Za-z-]+"
_REQUEST: Final = re.compile(rb"(%s) ([\x21-\x7e]+) HTTP/1\.([01])" % _TOKEN)
_RESPONSE: Final = re.compile(rb"HTTP/1\.([01]) ([1-5][0-9]{2})(?: [\t\x20-\x7e\x80-\xff]*)?")
_FIELD: Final = re.compile(rb"(%s):[ \t]*([\t\x20-\x7e\x80-\xff]*?)[ \t]*" % _TOKEN)
_LENGTH: Final = re.compile(rb"[0-9]{1,18}")
_ONCE: Final = (b"content-length", b"host", b"transfer-encoding")


@dataclass(frozen=True)
class Oversized:
    """Takes the place of a body that was longer than the limit, and is not kept.

    It is read to its end: a client that still writes would not read an answer, and roscpp repeats
    a call without one for ever.
    """

    length: int


class HttpReader:
    # Bytes in, whole messages out, one at a time.

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._data = b""
        self._rest: list[bytes] = []
        self._rest_size = 0  # of the pieces, none of which is empty
        self._begin = 0  # of the body, once the head is known
        self._end = 0
        self._dropped = 0  # bytes of a body that is too long
        self._left = 0  # and how many are still to come

    @property
    def pending(self) -> bool:
        # Whether a message has begun and was not taken.
        return bool(self._data or self._rest or self._left)

    @property
    def in_body(self) -> bool:
        # Whether the head of a message is known, and its body was not taken.
        return self._begin > 0 or self._dropped > 0

    def feed(self, data: bytes) -> None:
        if self._left and data:
            taken = min(self._left, len(data))
            self._left -= taken
            data = data[taken:]
        if data:
            self._rest.append(data)
            self._rest_size += len(data)

    def head(self) -> bytes | None:
        # The head without its end, or None while it is not complete.
        self._join()
        found = self._data.find(END, 0, HEADERS_LIMIT + len(END))
        if found < 0:
            if self._data and not b"A" <= self._data[:1] <= b"Z":
                raise HttpRefused("malformed HTTP")
            if len(self._data) > HEADERS_LIMIT:
                raise HttpRefused("HTTP headers that are too long", status=431)
            return None
        return self._data[:found]

    def expect(self, head: bytes, length: int) -> None:
        if length > self.limit:
            raise HttpRefused(f"an HTTP body longer than {self.limit} bytes", status=413)
        self._begin = len(head) + len(END)
        self._end = self._begin + length

    def drop(self, head: bytes, length: int) -> None:
        if length > DROP_LIMIT:
            raise HttpRefused(f"an HTTP body longer than {self.limit} bytes", status=413)
        rest = self._data[len(head) + len(END) :]
        self._data, self._dropped, self._left = b"", length, length
        self.feed(rest)

    def body(self) -> bytes | Oversized | None:
        # The body, or None while it is not complete.
        if self._dropped:
            if self._left:
                return None
            dropped, self._dropped = Oversized(self._dropped), 0
            return dropped
        if len(self._data) + self._rest_size < self._end:
            return None
        self._join()
        body = self._data[self._begin : self._end]
        self.skip(self._end)
        return body

    def rest(self, begin: int) -> bytes:
        rest, self._data = self._data[begin:], b""
        return rest

    def skip(self, count: int) -> None:
        self._data = self._data[count:]
        self._begin = self._end = 0

    def _join(self) -> None:
        if self._rest:
            self._data = b"".join((self._data, *self._rest))
            self._rest, self._rest_size = [], 0


def _connection(minor: bytes, fields: dict[bytes, bytes]) -> tuple[bool, bool]:
    # Whether it ends after this message, and whether it may be switched to the compact form (RFC 9110 7.8).
    options = [option.strip() for option in fields.get(b"connection", b"").lower().split(b",")]
    switches = minor == b"1" and fields.get(b"upgrade") == COMPACT and b"upgrade" in options
    return minor == b"0" or b"close" in options, switches


class HttpServer:
    def __init__(self, *, limit: int = BODY_LIMIT) -> None:
        self._reader = HttpReader(limit)
        self._answering = False
        self._last = False  # the current request asks to close the connection
        self.is_offered = False  # the current request may be answered with `SWITCH`
        self.closing = False  # no more requests are accepted (HTTP/1.0, close, an error)

    @property
    def pending(self) -> bool:
        # A request has begun and is not complete.
        return self._reader.pending

    def feed(self, data: bytes) -> None:
        if self.closing:
            raise HttpRefused("HTTP bytes after the end of the connection")
        self._reader.feed(data)

    def feed_whole(self, data: bytes) -> bytes | Oversized | None:
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
        if self._answering or self.closing:
            return None
        if not self._reader.in_body:
            data = self._reader.head()
            if data is None:
                return None
            head = _request_head(data) if len(data) > _MAX_CACHED else _cached_request_head(data)
            if head.length > self._reader.limit:
                self._reader.drop(data, head.length)
            else:
                self._reader.expect(data, head.length)
            self._last, self.is_offered = head.closes, head.offers
        body = self._reader.body()
        self._answering = body is not None
        return body

    def respond(self, body: bytes) -> bytes:
        self._answering = False
        self.closing = self._last
        return _message(b"HTTP/1.1 200 OK", body, close=self._last)

    def refuse(self, status: int) -> bytes:
        if self.closing:
            return b""
        self.closing = True
        reason = _REASONS[status]
        return _message(b"HTTP/1.1 %d %s" % (status, reason), reason + b"\n", close=True)


class _RequestHead(NamedTuple):
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
    minor, fields = request[3], _fields(rest)
    if minor == b"1" and b"host" not in fields:  # RFC 9112 section 3.2
        raise HttpRefused("malformed HTTP")
    if b"origin" in fields:  # from a browser of this host, without its user's knowledge
        raise HttpRefused("an HTTP request from a web page", status=403)
    closes, switches = _connection(minor, fields)
    return _RequestHead(_length(fields), closes, switches and not closes)


# The heads of one client are always the same bytes; refusals are not cached
_cached_request_head = lru_cache(256)(_request_head)


class HttpClient:
    def __init__(self, host: str, *, path: str = "/", limit: int = BODY_LIMIT) -> None:
        self._reader = HttpReader(limit)
        self._first = f"POST {path} HTTP/1.1\r\nHost: {host}".encode("ascii")
        self._offers = False
        self.switched: bytes | None = None
        """What follows the head by which the server took the offer; None: it did not."""
        self._waiting = False
        self._last = False

    @property
    def closing(self) -> bool:
        # The server will not answer another request on this connection.
        return self._waiting or self._last

    def request(self, body: bytes, *, offers: bool = False) -> bytes:
        self._waiting, self._offers = True, offers
        first = self._first + _OFFER if offers else self._first
        return _message(first, body, close=False)

    def feed(self, data: bytes) -> None:
        self._reader.feed(data)

    def take_back(self) -> None:
        # The last request is not sent.
        self._waiting = self._offers = False

    def next_response(self) -> bytes | None:
        # The body of the response, or None while it is not complete.
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
            if not (self._offers and _connection(response[1], fields)[1]):
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
        self._last = _connection(response[1], fields)[0]


def _fields(data: bytes) -> dict[bytes, bytes]:
    fields: dict[bytes, bytes] = {}
    for line in data.split(b"\r\n") if data else ():
        match = _FIELD.fullmatch(line)
        if match is None:
            raise HttpRefused("malformed HTTP")
        name = match[1].lower()
        # Repeated, these would leave the end of the body to the reader: request smuggling (RFC 9112 6.3).
        if name in fields and name in _ONCE:
            raise HttpRefused("malformed HTTP")
        fields[name] = fields[name] + b", " + match[2] if name in fields else match[2]
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
    return b"%s\r\nContent-Type: text/xml\r\nContent-length: %d%s\r\n\r\n%s" % (first, len(body), end, body)
