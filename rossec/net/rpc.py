"""XML-RPC over a secure stream, both sides; the master and the node's slave API share it.

A shell: framing is `rossec.ros.http`, marshalling `rossec.ros.xmlrpc`, the peer's identity comes
from the channel and is handed to the dispatcher with every call. One request at a time on one
connection, as in HTTP/1.1 without pipelining; a request that has begun must end within a deadline.
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable
from typing import Final, Generic, Protocol, TypeVar

from rossec.errors import HangUp, HttpRefused, RossecError, XmlRpcRefused
from rossec.ros import xmlrpc
from rossec.ros.http import HttpClient, HttpServer
from rossec.ros.xmlrpc import Fault

REQUEST_DEADLINE: Final = 10.0  # seconds from the first byte of a request to its last
CALL_DEADLINE: Final = 10.0
_FAULT_CODE: Final = 1  # the only one stock ROS uses

_log = logging.getLogger(__name__)
PeerT = TypeVar("PeerT")
PeerT_co = TypeVar("PeerT_co", covariant=True)
PeerT_contra = TypeVar("PeerT_contra", contravariant=True)


class Stream(Protocol[PeerT_co]):
    """What is used of `rossec.net.stream.SecureStream`."""

    @property
    def peer(self) -> PeerT_co:
        """The authenticated identity at the other end."""

    async def send(self, *pieces: bytes) -> None:
        """Send one unit."""

    async def receive(self) -> bytes:
        """The next unit. Raises a `RossecError` when the channel is closed."""

    async def close(self) -> None:
        """Close in order."""


class Dispatch(Protocol[PeerT_contra]):
    """Answers one call: returns the value, or raises `Fault`; `HangUp` ends the connection."""

    def __call__(
        self, method: str, params: tuple[object, ...], peer: PeerT_contra, /
    ) -> Awaitable[object]:
        """The value to answer with."""


class CallFailed(RossecError):
    """A call got no answer: the connection ended or the deadline passed."""


async def serve_calls(
    stream: Stream[PeerT],
    dispatch: Dispatch[PeerT],
    *,
    limit: int = xmlrpc.BODY_LIMIT,
    request_deadline: float = REQUEST_DEADLINE,
    idle_deadline: float | None = None,
) -> None:
    """Answer the calls on `stream` until the peer closes it or breaks the protocol.

    `idle_deadline` is how long it may take from one answer to the next, reading it included.
    """
    connection = _ServerLoop(
        stream, dispatch, HttpServer(limit=limit), request_deadline, idle_deadline
    )
    try:
        await connection.run()
    finally:
        await stream.close()


class _ServerLoop(Generic[PeerT]):
    """One connection being served."""

    def __init__(
        self,
        stream: Stream[PeerT],
        dispatch: Dispatch[PeerT],
        http: HttpServer,
        deadline: float,
        idle: float | None,
    ) -> None:
        self._stream = stream
        self._dispatch = dispatch
        self._http = http
        self._deadline = deadline
        self._idle = idle

    async def run(self) -> None:
        now, set_at = asyncio.get_running_loop().time, 0.0
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(self._idle) as idle:
                while not self._http.closing and await self._serve_one():
                    if self._idle is not None and now() > set_at + self._idle / 64:
                        set_at = now()  # not for each call: a timer costs more than many a call
                        idle.reschedule(set_at + self._idle)

    async def _serve_one(self) -> bool:
        """Answer one call; whether there may be another one."""
        try:
            body = await self._next_request()
            response = await self._answer(body)
        except HttpRefused as error:
            await self._stream.send(self._http.refuse(error.status))
            return False
        except RossecError:  # closed by the peer: no answer
            return False
        await self._stream.send(self._http.respond(response))
        return True

    async def _next_request(self) -> bytes:
        if (body := self._http.next_request()) is not None:
            return body
        self._http.feed(await self._stream.receive())
        if (body := self._http.next_request()) is not None:  # nearly always
            return body
        async with asyncio.timeout(self._deadline):
            while (body := self._http.next_request()) is None:
                self._http.feed(await self._stream.receive())
        return body

    async def _answer(self, body: bytes) -> bytes:
        try:
            call = xmlrpc.load_call(body)
            return xmlrpc.dump_response(await self._value(call))
        except XmlRpcRefused as error:
            return xmlrpc.dump_response(Fault(_FAULT_CODE, str(error)))

    async def _value(self, call: xmlrpc.Call) -> object:
        try:
            return await self._dispatch(call.method, call.params, self._stream.peer)
        except Fault as fault:
            return fault
        except HangUp:
            raise
        except Exception:  # noqa: BLE001
            # A fault of ours must neither end the other calls nor tell the peer about our inside.
            _log.exception("a call failed inside")
            return Fault(_FAULT_CODE, "rossec: internal error")


class RpcClient:
    """Calls methods of the peer at the other end of a stream, one at a time.

    After a call that failed on the way (deadline, broken protocol) the stream is closed: a late
    answer must not be taken for the answer to the next call.
    """

    def __init__(
        self,
        stream: Stream[object],
        *,
        host: str = "rossec",
        deadline: float = CALL_DEADLINE,
        limit: int = xmlrpc.BODY_LIMIT,
    ) -> None:
        self._stream = stream
        self._http = HttpClient(host, limit=limit)
        self._deadline = deadline
        self._limit = limit
        self._turn = asyncio.Lock()
        self._closed = False

    @property
    def closed(self) -> bool:
        """No call can succeed any more: connect anew."""
        return self._closed

    async def call(self, method: str, *params: object) -> object:
        """The value of the response.

        Raises:
            Fault: the server answered with a fault.
            CallFailed: no answer, or none in time.
            WireError: the answer is not XML-RPC over HTTP.
            XmlRpcRefused: a parameter cannot be carried (nothing was sent).
        """
        return xmlrpc.load_response(await self.fetch(method, *params), limit=self._limit)

    async def fetch(self, method: str, *params: object) -> bytes:
        """Like `call`, but the body of the response, unparsed.

        Raises:
            CallFailed, WireError, XmlRpcRefused: as `call`.
        """
        request = xmlrpc.dump_call(method, params)
        async with self._turn:
            return await self._exchange(method, request)

    async def ask(self, method: str, *params: object) -> object:
        """Like `call`, for ROS methods: the value in `[1, status, value]`.

        Raises:
            AnswerRefused, AnswerMalformed: see `rossec.ros.xmlrpc.value_of`; and as `call`.
        """
        return xmlrpc.value_of(await self.call(method, *params))

    async def close(self) -> None:
        """End the connection; calls under way fail."""
        self._closed = True
        await self._stream.close()

    async def _exchange(self, method: str, request: bytes) -> bytes:
        if self._closed:
            raise CallFailed(f"{method}: the connection is closed")
        complete = False
        try:
            async with asyncio.timeout(self._deadline):
                await self._stream.send(self._http.request(request))
                body = await self._response()
            complete = not self._http.closing
        except TimeoutError as error:
            raise CallFailed(f"{method}: no answer within {self._deadline:g} s") from error
        finally:
            if not complete:
                await self._give_up()
        return body

    async def _response(self) -> bytes:
        while (body := self._http.next_response()) is None:
            self._http.feed(await self._stream.receive())
        return body

    async def _give_up(self) -> None:
        self._closed = True
        with contextlib.suppress(RossecError):
            await self._stream.close()
