"""Calls and answers as bytes: XML-RPC over HTTP, then units of the compact form, if both can. Sans-IO.

A unit is one deterministic CBOR array and fills what the channel delivers at once
(docs/spec/compact.md). The number of a call, modulo 24, is in the call and in its answer. The shape
of an answer says what it is: ROS's code, status and value; any other value; a fault; or a body of
XML-RPC as a program gave it. The first request offers the compact form and is an ordinary call: a
peer that does not know it answers as ever; one that does answers `101` and then with units, so that
no round trip is lost. One call at a time: all else ends the connection.
"""

from collections.abc import Generator, Sequence
from typing import Final

from ca.encoding import head
from rossec.errors import CompactRefused, XmlRpcRefused
from rossec.peer_limits import printable
from rossec.ros import xmlrpc
from rossec.ros.compact_values import (
    ARRAY,
    DEPTH_LIMIT,
    ITEM_BYTES,
    MALFORMED,
    NULL,
    UINT,
    CompactReader,
    Pieces,
    encoded_number,
    encoded_text,
    put,
)
from rossec.ros.http import SWITCH, HttpClient, HttpServer, Oversized
from rossec.ros.xmlrpc import BODY_LIMIT, METHOD_LIMIT, NOT_ENCODABLE, Call, Encoded, Fault, run_out, too_long

# They are part of the format: never change one, and never add one. A method that came later is called
# by its name, since a peer of today would refuse an unknown number. Those below 24 take one byte.
_NUMBERED: Final = """
getParam setParam hasParam registerPublisher registerSubscriber registerService unregisterPublisher
unregisterSubscriber unregisterService lookupNode lookupService getSystemState publisherUpdate
paramUpdate requestTopic rossec.presentGrants rossec.revocationUpdate rossec.revocationsSince
rossec.watchGraph rossec.watchGrants rossec.followSite rossec.relayForwardedPorts getPid getUri
getPublishedTopics getTopicTypes getParamNames searchParam deleteParam subscribeParam
unsubscribeParam shutdown system.multicall getName getMasterUri getBusStats getBusInfo
getSubscriptions getPublications rossec.renewGrants rossec.renewIdentity rossec.updateDelegation
rossec.revocations rossec.updateRevocations rossec.updateRevocationTree rossec.revocationEntries
rossec.revocationProofs rossec.domains rossec.updateDomains rossec.foreignRevocations
rossec.foreignRevocationProofs rossec.trl rossec.relayTarget rossec.depositGrants
rossec.deliveryStates rossec.revocationStatus rossec.recentDenials rossec.fetchGrants
rossec.domainsUpdate rossec.foreignRevocationUpdate rossec.ports
"""
METHODS: Final = tuple(_NUMBERED.split())
NUMBERS: Final = {name: number for number, name in enumerate(METHODS)}

TURNS: Final = 24  # calls are numbered modulo this: one byte
_CALL: Final = 0x52
_MARK: Final = head(UINT, _CALL)
_PARTS: Final = 3  # mark, number, method
_ARRAYS: Final = tuple(head(ARRAY, size) for size in range(24))
_METHODS: Final = {name: head(UINT, place) for name, place in NUMBERS.items()}
_TURNS: Final = tuple(head(UINT, turn) for turn in range(TURNS))
_MALFORMED: Final = "a unit that ends too early, or has a text that is not UTF-8"
# The one method whose answer is passed on as a program gave it: roscpp's is malformed XML
UNPARSED: Final = "getBusStats"
_BEGINNINGS: Final = tuple(_MARK + turn for turn in _TURNS)
_TRIPLE, _FAULT, _VALUE = 4, 3, 2  # items of an answer
_RAW: Final = 0  # it has as many as a fault
_OWN: Final = b"rossec."
_XML_OWN: Final = b"<methodName>" + _OWN
_HEAD: Final = 256  # bytes of an XML body in which its method is named
_METHOD_AT: Final = 4  # where it is in nearly every unit
_ONE_BYTE: Final = 24  # then a number of 24 and above follows (RFC 8949 section 3)


def dump_compact_call(turn: int, method: str, params: Sequence[object]) -> bytes:
    size = _PARTS + len(params)
    begin = _ARRAYS[size] if size < 24 else head(ARRAY, size)
    out = Pieces((begin, _MARK, _TURNS[turn]))
    try:
        known = _METHODS.get(method)
        out.append(encoded_text(method) if known is None else known)
        for param in params:
            put(param, out)
    except NOT_ENCODABLE as error:
        raise XmlRpcRefused(f"a value that XML-RPC cannot carry: {error}") from error
    return b"".join(out)


def load_compact_call(data: bytes, turn: int, *, limit: int = BODY_LIMIT) -> Call:
    reader = _reader(data, limit)
    try:
        if data[1:4] == _BEGINNINGS[turn] and 0x83 <= data[0] < 0x98 and data[4] < 24:
            size, method = data[0] - ARRAY, METHODS[data[4]]  # nearly every call begins so
            reader.at = 5
        else:
            size, method = _begin(reader, turn)
        params = tuple(reader.items(size - _PARTS))
    except MALFORMED as error:
        raise CompactRefused(_MALFORMED) from error
    _check_end(reader)
    return Call(method, params)


def compact_call_steps(data: bytes, turn: int, *, limit: int = BODY_LIMIT) -> Generator[None, None, Call]:
    reader = _reader(data, limit)
    try:
        size, method = _begin(reader, turn)
        params = yield from reader.steps(size - _PARTS)
    except MALFORMED as error:
        raise CompactRefused(_MALFORMED) from error
    _check_end(reader)
    return Call(method, (*params,))


def _begin(reader: CompactReader, turn: int) -> tuple[int, str]:
    size = reader.head(ARRAY)
    if size < _PARTS or reader.head(UINT) != _CALL:
        raise CompactRefused("a unit that is not a call")
    _check_turn(reader, turn)
    (method,) = reader.items(1)
    if type(method) is int and 0 <= method < len(METHODS):
        return size, METHODS[method]
    # One form for each method: a name that has a number is refused.
    if not isinstance(method, str) or not 0 < len(method) <= METHOD_LIMIT or method in NUMBERS:
        raise CompactRefused("a call of a method that has no such number or name")
    return size, method


def load_compact_answer(data: bytes, turn: int, method: str, *, limit: int = BODY_LIMIT) -> object:
    # A fault is returned, not raised; its text is made printable.
    return run_out(compact_answer_steps(data, turn, method, limit=limit, at_once=True))


def compact_answer_steps(
    data: bytes, turn: int, method: str, *, limit: int = BODY_LIMIT, at_once: bool = False
) -> Generator[None, None, object]:
    reader = _reader(data, limit)
    try:
        # 1. What it is, how many items it has, and how deep they are nested.
        size = reader.head(ARRAY)
        _check_turn(reader, turn)
        shape, count, depth = size, size - 1, DEPTH_LIMIT - (size == _TRIPLE)
        if size == _FAULT and reader.skip(NULL):
            shape, count, depth = _RAW, 1, DEPTH_LIMIT
        elif size not in (_TRIPLE, _FAULT, _VALUE):
            raise CompactRefused("a unit that is not an answer")
        # 2. The items; each shape has one form, so that no two readers take an answer for different ones.
        found = reader.items(count, depth) if at_once else (yield from reader.steps(count, depth))
        value = _answer(shape, found, method)
    except MALFORMED as error:
        raise CompactRefused(_MALFORMED) from error
    _check_end(reader)
    return value


def _answer(shape: int, found: list[object], method: str) -> object:
    if shape == _TRIPLE:
        if not _is_triple(found):
            raise CompactRefused("an answer whose code or status has the wrong type")
        return found
    if shape == _FAULT:
        code, reason = found
        if type(code) is not int or not isinstance(reason, str):
            raise CompactRefused("a fault whose code or text has the wrong type")
        return Fault(code, printable(reason))
    (value,) = found
    if shape == _RAW:
        if not isinstance(value, bytes) or method != UNPARSED:
            raise CompactRefused(f"a body of XML-RPC in the answer to {printable(method)}")
        return Encoded(value)
    if isinstance(value, list) and _is_triple(value):
        raise CompactRefused("an answer whose code and status are inside its value")
    return value


def dump_compact_answer(turn: int, value: object, *, limit: int = BODY_LIMIT) -> bytes:
    out, size = Pieces((b"", _TURNS[turn])), _VALUE
    try:
        if isinstance(value, Fault):
            out += encoded_number(value.faultCode), encoded_text(value.faultString)
            size = _FAULT
        elif isinstance(value, Encoded):
            out.append(NULL)
            put(value.body, out)
            size = _FAULT
        elif isinstance(value, list | tuple) and _is_triple(value):
            out += encoded_number(value[0]), encoded_text(value[1])
            put(value[2], out, DEPTH_LIMIT - 1)
            size = _TRIPLE
        else:
            put(value, out)
    except NOT_ENCODABLE as error:
        raise XmlRpcRefused(f"a value that XML-RPC cannot carry: {error}") from error
    out[0] = _ARRAYS[size]
    unit = b"".join(out)
    # Values are counted, not bytes alone: one may take one byte here, and no XML-RPC body has so many.
    if len(unit) > limit or out.values > limit // ITEM_BYTES:
        raise too_long(len(unit), limit)
    return unit


def _is_triple(value: Sequence[object]) -> bool:
    return len(value) == 3 and type(value[0]) is int and type(value[1]) is str


def _reader(data: bytes, limit: int) -> CompactReader:
    if len(data) > limit:
        raise CompactRefused(f"a unit of {len(data)} bytes where at most {limit} are allowed")
    return CompactReader(data, limit)


def _check_turn(reader: CompactReader, turn: int) -> None:
    if reader.head(UINT) != turn:
        raise CompactRefused("a unit out of its turn")


def _check_end(reader: CompactReader) -> None:
    if not reader.at_end:
        raise CompactRefused("a unit with bytes after its end, or without some before")


class CallClient:
    """`request`, `take` until it is not None, again; `limit`: bytes of an answer."""

    # `compact`: offer the compact form; only where units arrive as they were sent.
    def __init__(self, host: str, *, limit: int = BODY_LIMIT, compact: bool = True) -> None:
        self._http = HttpClient(host, limit=limit)
        self._limit = limit
        self._offers = compact
        self._method: str | None = None  # of the call that is not answered yet
        self._turn = 0
        self.is_compact = False  # units are exchanged

    @property
    def closing(self) -> bool:
        """Whether the peer answers no other call: it said so, or the last one has no answer."""
        return self._method is not None or (not self.is_compact and self._http.closing)

    def request(self, method: str, params: Sequence[object]) -> bytes:
        """The bytes of a call, after the last one was answered."""
        if self.is_compact:
            unit = dump_compact_call(self._turn, method, params)
            self._method = method
            return unit
        body = xmlrpc.dump_call(method, params)
        self._method, offers, self._offers = method, self._offers, False
        return self._http.request(body, offers=offers)

    def take_back(self) -> None:
        # The last request is not sent, so that another may be made. A first one may have offered the compact
        # form: the next one offers nothing.
        self._method = None
        self._http.take_back()

    def take(self, data: bytes) -> object:
        """The answer, when it is whole: a value, a `Fault`, or a body of XML-RPC that is `Encoded`."""
        return run_out(self.take_steps(data, at_once=True))

    def take_steps(self, data: bytes, *, at_once: bool = False) -> Generator[None, None, object]:
        """As `take`, in steps: it yields after each."""
        unit = self._received(data)
        if not isinstance(unit, bytes):
            return unit
        if self._method is None:
            raise CompactRefused("an answer to no call")
        turn, method, limit = self._turn, self._method, self._limit
        answer = yield from compact_answer_steps(unit, turn, method, limit=limit, at_once=at_once)
        self._method, self._turn = None, (turn + 1) % TURNS
        return answer

    def _received(self, data: bytes) -> bytes | Encoded | None:
        if self.is_compact:
            return data
        self._http.feed(data)
        body = self._http.next_response()
        if body is not None:
            self._method = None
            return Encoded(body)
        if self._http.switched is not None:
            self.is_compact = True
        return self._http.switched


def value_in(answer: object, limit: int = BODY_LIMIT) -> object:
    if isinstance(answer, Encoded):
        return xmlrpc.load_response(answer.body, limit=limit)
    if isinstance(answer, Fault):
        raise answer
    return answer


def value_steps(body: Encoded, limit: int = BODY_LIMIT) -> Generator[None, None, object]:
    """As `value_in` of a body, in steps: it yields after each."""
    return xmlrpc.response_steps(body.body, limit=limit)


def body_of(answer: object) -> bytes:
    """What was answered as a response of XML-RPC, unparsed if it came so."""
    return xmlrpc.dump_response(answer)


class CallServer:
    """`take`, `load`, `respond`, again; `limit`: bytes of a call, and of an answer.

    `compact`: take the offer; only where units arrive as they were sent.
    """

    __slots__ = ("_http", "_limit", "_takes_offers", "_turn", "answering", "is_compact")

    def __init__(self, *, limit: int = BODY_LIMIT, compact: bool = True) -> None:
        self._http = HttpServer(limit=limit)
        self._limit = limit
        self._takes_offers = compact
        self._turn = 0
        self.answering = False  # a unit has to be answered before another one may come
        self.is_compact = False  # units are exchanged

    @property
    def pending(self) -> bool:
        """Whether a request has begun and is not complete."""
        return not self.is_compact and self._http.pending

    @property
    def closing(self) -> bool:
        return self._http.closing

    def take(self, unit: bytes | None = None) -> bytes | Oversized | None:
        """The next whole request, after taking `unit`; None: there is none yet."""
        if not self.is_compact:
            return self._http.next_request() if unit is None else self._http.feed_whole(unit)
        if unit is None:
            return None
        if self.answering:
            raise CompactRefused("a call before the answer to the last one")
        self.answering = True
        return unit

    def load(self, request: bytes | Oversized, bound: int | None = None) -> Call:
        """The call that `take` returned; `bound`: bytes that this caller may have parsed now."""
        request = self._bounded(request, bound)
        if self.is_compact:
            return load_compact_call(request, self._turn, limit=self._limit)
        return xmlrpc.load_call(request, limit=self._limit)

    def load_steps(self, request: bytes | Oversized, bound: int | None = None) -> Generator[None, None, Call]:
        """As `load`, in steps: it yields after each."""
        request = self._bounded(request, bound)
        if self.is_compact:
            return compact_call_steps(request, self._turn, limit=self._limit)
        return xmlrpc.call_steps(request, limit=self._limit)

    def _bounded(self, request: bytes | Oversized, bound: int | None) -> bytes:
        # The request, unless it is too long.
        if isinstance(request, Oversized):
            raise XmlRpcRefused(f"a call of {request.length} bytes where at most {self._limit} are allowed")
        if bound is None or len(request) <= bound:
            return request
        # A call that shows grants may be longer, and one that hands in another signed statement. Which it is
        # must be known before it is parsed: parsing is what the bound spares the master.
        number = 0 if not self.is_compact else request[_METHOD_AT]
        number = request[_METHOD_AT + 1] if number == _ONE_BYTE else number
        if not self.is_compact:
            has_statements = _XML_OWN in request[:_HEAD]
        elif number < len(METHODS):
            has_statements = METHODS[number].startswith("rossec.")
        else:
            has_statements = request.find(_OWN, _METHOD_AT, _METHOD_AT + 8) > 0
        if has_statements:
            return request
        raise XmlRpcRefused(
            f"a call of {len(request)} bytes, at most {bound} are taken from a caller that has shown no grant"
        )

    def respond(self, value: object) -> bytes:
        """The bytes of the answer; `value` may be a `Fault`, or `Encoded`."""
        http = self._http
        if self.is_compact or (self._takes_offers and http.is_offered and not http.pending):
            unit = dump_compact_answer(self._turn, value, limit=self._limit)
            self._turn = (self._turn + 1) % TURNS
            self.answering = False
            if self.is_compact:
                return unit
            self.is_compact = True
            return SWITCH + unit
        body = xmlrpc.dump_response(value)
        if len(body) > self._limit:
            raise xmlrpc.too_long(len(body), self._limit)
        return http.respond(body)

    def refuse(self, status: int) -> bytes:
        return self._http.refuse(status)
