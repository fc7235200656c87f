"""XML-RPC over a secure stream, both sides; the master and the node's slave API share it.

A shell: framing is `rossec.ros.http`, marshalling `rossec.ros.xmlrpc`, the peer's identity comes
from the channel and is passed to the dispatcher with every call. One request at a time on one
connection, as in HTTP/1.1 without pipelining; a request that has begun must end within a deadline.
"""

import asyncio
import contextlib
from typing import Final, Protocol, TypeVar

from rossec.errors import RossecError
from rossec.net.rpc.server import CallLoop, Dispatch, ServedStream
from rossec.ros import xmlrpc
from rossec.ros.http import HttpClient

REQUEST_DEADLINE: Final = 10.0  # seconds from the first byte of a request to its last
CALL_DEADLINE: Final = 10.0
PeerT = TypeVar("PeerT")


class Stream(Protocol):
    """What a client uses of `rossec.net.aio.SecureStream`."""

    async def send(self, *pieces: bytes) -> None:
        """Send one unit."""

    async def receive(self) -> bytes:
        """The next unit. Raises a `RossecError` when the channel is closed."""

    async def close(self) -> None:
        """Close in order."""


class CallFailed(RossecError):
    """A call got no answer: the connection ended or the deadline passed."""


async def serve_calls(
    stream: ServedStream[PeerT],
    dispatch: Dispatch[PeerT],
    *,
    limit: int = xmlrpc.BODY_LIMIT,
    request_deadline: float = REQUEST_DEADLINE,
    idle_deadline: float | None = None,
) -> None:
    """Answer the calls on `stream` until the peer closes it or breaks the protocol.

    `dispatch` may return an awaitable; any other value is answered at once.
    `idle_deadline` is how long it may take from one answer to the next, reading it included.
    """
    calls = CallLoop(stream, dispatch, limit=limit, deadline=request_deadline, idle=idle_deadline)
    try:
        await calls.run()
    finally:
        await stream.close()


class RpcClient:
    """Calls methods of the peer at the other end of a stream, one at a time.

    After a failed call (deadline, protocol error) the stream is closed: a late answer must not be
    taken for the answer to the next call.
    """

    def __init__(
        self,
        stream: Stream,
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
        """No call can succeed any more: connect again."""
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
                await self._abandon()
        return body

    async def _response(self) -> bytes:
        while (body := self._http.next_response()) is None:
            self._http.feed(await self._stream.receive())
        return body

    async def _abandon(self) -> None:
        self._closed = True
        with contextlib.suppress(RossecError):
            await self._stream.close()
