"""The calling side of one connection, sans-IO: XML-RPC over HTTP, then units, if the peer can.

The first request offers the compact form and is an ordinary call: a peer that does not know it
answers as ever, and is asked in XML-RPC for the rest of the connection. A peer that does answers
`101` and then with units (`rossec.ros.compact`). One call at a time; an answer of another number,
or one that nobody waits for, ends the connection.
"""

from collections.abc import Generator, Sequence

from rossec.errors import CompactRefused
from rossec.ros import compact, xmlrpc
from rossec.ros.http import HttpClient
from rossec.ros.xmlrpc import BODY_LIMIT, Encoded, Fault


class CallClient:
    """`request`, `take` until it is not None, again.

    Args:
        host: of the peer, for HTTP.
        limit: bytes of an answer.
        compact: offer the compact form; only where units arrive as they were sent.
    """

    def __init__(self, host: str, *, limit: int = BODY_LIMIT, compact: bool = True) -> None:
        self._http = HttpClient(host, limit=limit)
        self._limit = limit
        self._offers = compact
        self._method: str | None = None  # of the call that is not answered yet
        self._turn = 0
        self.is_compact = False
        """Whether units are exchanged."""

    @property
    def closing(self) -> bool:
        """Whether the peer answers no other call: it said so, or the last one has no answer."""
        return self._method is not None or (not self.is_compact and self._http.closing)

    def request(self, method: str, params: Sequence[object]) -> bytes:
        """The bytes of a call, after the last one was answered.

        Raises:
            XmlRpcRefused: a parameter cannot be carried; nothing is under way.
        """
        if self.is_compact:
            unit = compact.dump_call(self._turn, method, params)
            self._method = method
            return unit
        body = xmlrpc.dump_call(method, params)
        self._method, offers, self._offers = method, self._offers, False
        return self._http.request(body, offers=offers)

    def take_back(self) -> None:
        """The last request is not sent, so that another may be made.

        A first one may have offered the compact form: the next one offers nothing.
        """
        self._method = None
        self._http.take_back()

    def take(self, data: bytes) -> object:
        """The answer, when it is whole: a value, a `Fault`, or a body of XML-RPC that is `Encoded`.

        None: it is not. See `value_in` and `body_of`.

        Raises:
            HttpRefused, CompactRefused: it is malformed, or nobody waits for it.
        """
        unit = self._received(data)
        if not isinstance(unit, bytes):
            return unit
        answer = compact.load_answer(unit, self._turn, self._waiting_for(), limit=self._limit)
        self._answered()
        return answer

    def take_steps(self, data: bytes) -> Generator[None, None, object]:
        """As `take`, in steps: it yields after each."""
        unit = self._received(data)
        if not isinstance(unit, bytes):
            return unit
        answer = yield from compact.answer_steps(
            unit, self._turn, self._waiting_for(), limit=self._limit
        )
        self._answered()
        return answer

    def _received(self, data: bytes) -> bytes | Encoded | None:
        """The unit that answers, or the body of XML-RPC that does, once it is whole."""
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

    def _waiting_for(self) -> str:
        """The method of the call that is answered."""
        if self._method is None:
            raise CompactRefused("an answer to no call")
        return self._method

    def _answered(self) -> None:
        self._method, self._turn = None, (self._turn + 1) % compact.TURNS


def value_in(answer: object, limit: int = BODY_LIMIT) -> object:
    """The value that was answered.

    Raises:
        Fault: the peer answered with a fault.
        XmlRpcRefused: a body that is not a response.
    """
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
