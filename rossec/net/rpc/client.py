"""Calls over a secure stream, both sides; the master and the node's slave API share it.

A shell: what is sent is decided by `rossec.ros.callclient` and `rossec.ros.callserver`, XML-RPC
over HTTP or the compact form; the peer's identity comes from the channel and is passed to the
dispatcher with every call. One call at a time on one connection, as in HTTP/1.1 without pipelining;
a request that has begun must end within a deadline.
"""

import asyncio
import contextlib
from collections.abc import Callable
from typing import Final, Protocol, TypeVar

from rossec.errors import ChannelError, RossecError, XmlRpcRefused
from rossec.net.bounds import UNSHOWN_UNIT
from rossec.net.rpc.server import CallLoop, Dispatch, ServedStream
from rossec.net.rpc.turns import AT_ONCE, TurnOwner, of_loop
from rossec.ros import xmlrpc
from rossec.ros.callclient import CallClient, body_of, value_in, value_steps
from rossec.ros.xmlrpc import BODY_LIMIT, Encoded

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
    compact: bool = True,
    bound: Callable[[], int] | None = None,
    urgent: bool = False,
) -> None:
    """Answer the calls on `stream` until the peer closes it or breaks the protocol.

    `dispatch` may return an awaitable; any other value is answered at once.
    `idle_deadline` is how long it may take from one answer to the next, reading it included.
    `compact`: take an offer of the compact form; not from a program, whose bytes come as they may.
    `bound`: how long a call may be that is parsed now, for a peer without rights less than `limit`.
    `urgent`: long calls of this peer precede those of others.
    """
    calls = CallLoop(
        stream, dispatch, limit=limit, deadline=request_deadline, idle=idle_deadline,
        compact=compact, bound=bound, urgent=urgent,
    )  # fmt: skip
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
        compact: bool = True,
    ) -> None:
        self._stream = stream
        self._calls = CallClient(host, limit=limit, compact=compact)
        self._deadline = deadline
        self._limit = limit
        self._turn = asyncio.Lock()
        self._source = TurnOwner(self, self)
        self._closed = False

    @property
    def closed(self) -> bool:
        """No call can succeed any more: connect again."""
        return self._closed

    @property
    def is_compact(self) -> bool:
        """Whether the peer took the offer of the compact form."""
        return self._calls.is_compact

    async def call(self, method: str, *params: object) -> object:
        """The value of the response.

        Raises:
            Fault: the server answered with a fault.
            CallFailed: no answer, or none in time.
            WireError: the answer is malformed.
            XmlRpcRefused: a parameter cannot be carried (nothing was sent).
        """
        answer = await self._answer(method, params)
        if isinstance(answer, Encoded) and len(answer.body) > AT_ONCE:
            return await of_loop().run(self._source, value_steps(answer, self._limit))
        return value_in(answer, self._limit)

    async def fetch(self, method: str, *params: object) -> bytes:
        """Like `call`, but the body of an XML-RPC response, unparsed if it came so.

        Raises:
            CallFailed, WireError, XmlRpcRefused: as `call`.
        """
        return body_of(await self._answer(method, params))

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

    async def _answer(self, method: str, params: tuple[object, ...]) -> object:
        async with self._turn:
            if self._closed:
                raise CallFailed(f"{method}: the connection is closed")
            request = self._calls.request(method, params)
            if len(request) > BODY_LIMIT:
                self._calls.take_back()
                raise XmlRpcRefused(
                    f"a call of {len(request)} bytes, at most {BODY_LIMIT} are sent"
                )
            try:
                return await self._exchange(method, request)
            except ChannelError as error:
                if len(request) <= UNSHOWN_UNIT:
                    raise
                raise XmlRpcRefused(
                    f"a call of {len(request)} bytes ended the connection: without a grant at most"
                    f" {UNSHOWN_UNIT} are taken"
                ) from error

    async def _exchange(self, method: str, request: bytes) -> object:
        complete = False
        try:
            async with asyncio.timeout(self._deadline):
                await self._stream.send(request)
                while (answer := await self._take(await self._stream.receive())) is None:
                    pass
            complete = not self._calls.closing
        except TimeoutError as error:
            raise CallFailed(f"{method}: no answer within {self._deadline:g} s") from error
        finally:
            if not complete:
                await self._abandon()
        return answer

    async def _take(self, data: bytes) -> object:
        if len(data) <= AT_ONCE:
            return self._calls.take(data)
        return await of_loop().run(self._source, self._calls.take_steps(data))

    async def _abandon(self) -> None:
        self._closed = True
        with contextlib.suppress(RossecError):
            await self._stream.close()
