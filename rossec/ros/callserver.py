"""The answering side of one connection, sans-IO: XML-RPC over HTTP, then units, if that is offered.

A caller that can offers the compact form in its first request (`rossec.ros.compact`); its answer is
the first unit, so that no round trip is lost. From then on nothing but units is taken, one call at
a time: a call before the answer to the last one is refused. What is not in the table of the two
phases ends the connection.
"""

from collections.abc import Generator
from typing import Final

from rossec.errors import CompactRefused, XmlRpcRefused
from rossec.ros import compact, xmlrpc
from rossec.ros.http import HttpServer
from rossec.ros.httpread import Oversized
from rossec.ros.methodnumbers import METHODS
from rossec.ros.xmlrpc import BODY_LIMIT, Call

_FIRST: Final = 0
_OWN: Final = b"rossec."
_XML_OWN: Final = b"<methodName>" + _OWN
_HEAD: Final = 256  # bytes of an XML body in which its method is named
_METHOD_AT: Final = 4  # where it is in nearly every unit


class CallServer:
    """`take`, `load`, `respond`, again.

    Args:
        limit: bytes of a call, and of an answer.
        compact: take the offer; only where units arrive as they were sent.
    """

    __slots__ = ("_http", "_limit", "_takes_offers", "_turn", "answering", "is_compact")

    def __init__(self, *, limit: int = BODY_LIMIT, compact: bool = True) -> None:
        self._http = HttpServer(limit=limit)
        self._limit = limit
        self._takes_offers = compact
        self._turn = _FIRST
        self.answering = False
        """Whether a unit has to be answered before another one may come."""
        self.is_compact = False
        """Whether units are exchanged."""

    @property
    def pending(self) -> bool:
        """Whether a request has begun and is not complete."""
        return not self.is_compact and self._http.pending

    @property
    def closing(self) -> bool:
        """Whether no more calls are accepted."""
        return self._http.closing

    def take(self, unit: bytes | None = None) -> bytes | Oversized | None:
        """The next whole request, after taking `unit`; None: there is none yet.

        Raises:
            HttpRefused: send `refuse(error.status)`, then close.
            CompactRefused: close.
        """
        if not self.is_compact:
            return self._http.next_request() if unit is None else self._http.feed_whole(unit)
        if unit is None:
            return None
        if self.answering:
            raise CompactRefused("a call before the answer to the last one")
        self.answering = True
        return unit

    def load(self, request: bytes | Oversized, bound: int | None = None) -> Call:
        """The call in a request.

        Args:
            request: what `take` returned.
            bound: bytes that this caller may have parsed now, fewer than `limit`.

        Raises:
            XmlRpcRefused: too long or malformed; answer with a fault.
            CompactRefused: malformed; close.
        """
        request = self._bounded(request, bound)
        if self.is_compact:
            return compact.load_call(request, self._turn, limit=self._limit)
        return xmlrpc.load_call(request, limit=self._limit)

    def load_steps(
        self, request: bytes | Oversized, bound: int | None = None
    ) -> Generator[None, None, Call]:
        """As `load`, in steps: it yields after each."""
        request = self._bounded(request, bound)
        if self.is_compact:
            return compact.call_steps(request, self._turn, limit=self._limit)
        return xmlrpc.call_steps(request, limit=self._limit)

    def _bounded(self, request: bytes | Oversized, bound: int | None) -> bytes:
        """The request, unless it is too long.

        A call that shows grants may be longer, and one that hands in another signed statement.
        """
        if isinstance(request, Oversized):
            raise XmlRpcRefused(
                f"a call of {request.length} bytes where at most {self._limit} are allowed"
            )
        if bound is not None and len(request) > bound and not self._has_statements(request):
            raise XmlRpcRefused(
                f"a call of {len(request)} bytes, at most {bound} are taken from a caller"
                " that has shown no grant"
            )
        return request

    def _has_statements(self, request: bytes) -> bool:
        """Whether it calls a method of rossec's own, as far as its first bytes tell."""
        if not self.is_compact:
            return _XML_OWN in request[:_HEAD]
        number = request[_METHOD_AT]
        if number < len(METHODS):
            return METHODS[number].startswith("rossec.")
        return request.find(_OWN, _METHOD_AT, _METHOD_AT + 8) > 0

    def respond(self, value: object) -> bytes:
        """The bytes of the answer; `value` may be a `Fault`, or `Encoded`.

        Raises:
            XmlRpcRefused, Fault: it cannot be sent; the call may still be answered otherwise.
        """
        http = self._http
        if self.is_compact or (self._takes_offers and http.is_offered and not http.pending):
            unit = compact.dump_answer(self._turn, value, limit=self._limit)
            self._turn = (self._turn + 1) % compact.TURNS
            self.answering = False
            if self.is_compact:
                return unit
            self.is_compact = True
            return http.switch() + unit
        body = xmlrpc.dump_response(value)
        if len(body) > self._limit:
            raise xmlrpc.too_long(len(body), self._limit)
        return http.respond(body)

    def refuse(self, status: int) -> bytes:
        """The bytes of an error response, which ends the connection."""
        return self._http.refuse(status)
