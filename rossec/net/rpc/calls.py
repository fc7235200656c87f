"""Calls over a secure stream, both sides: one at a time, as in HTTP/1.1 without pipelining.

Both forms of a call (`rossec.ros.calls`: XML-RPC over HTTP, or compact) go to the same dispatcher, with the
peer's identity from the channel. A call whose value is available at once costs no task switch, no timer and
no turn of the loop; `run` awaits what takes time (an awaitable value, a peer that does not read). One call is
answered in each turn of the loop, so that one peer with many calls cannot keep the others waiting. A long one
is parsed and answered in the turns of its peer (`rossec.net.rpc.time_slices`), as is a short one when others
of this pass took long, and one that is too long for what the peer has shown is answered with a fault,
unparsed.
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable, Coroutine, Generator
from dataclasses import KW_ONLY, InitVar, dataclass, field
from time import monotonic
from typing import Any, Final, Generic, NamedTuple, Protocol, TypeAlias, TypeVar

from rossec.errors import ChannelError, CompactRefused, HangUp, HttpRefused, RossecError, XmlRpcRefused
from rossec.net.limits import UNSHOWN_UNIT
from rossec.net.rpc.time_slices import AT_ONCE, URGENT, LoopTurns, TurnOwner, of_loop, source_of
from rossec.ros import xmlrpc
from rossec.ros.calls import CallClient, CallServer, body_of, value_in, value_steps
from rossec.ros.http import Oversized
from rossec.ros.xmlrpc import BODY_LIMIT, FAULT_CODE, Encoded, Fault

REQUEST_DEADLINE: Final = 10.0  # seconds from the first byte of a request to its last
CALL_DEADLINE: Final = 10.0
_CRASHED: Final = Fault(FAULT_CODE, "rossec: internal error")

_log = logging.getLogger("rossec.net.callloop")
PeerT = TypeVar("PeerT")
PeerT_co = TypeVar("PeerT_co", covariant=True)


class _Message(NamedTuple):
    data: bytes


class ServedStream(Protocol[PeerT_co]):
    @property
    def peer(self) -> PeerT_co: ...

    # Call back, not at once, whenever `next_unit` has a new result.
    # `take` may be offered a unit at once instead; it returns whether it took it.
    def on_ready(
        self, callback: Callable[[], None] | None, take: Callable[[bytes], bool] | None = None
    ) -> None: ...

    @property
    def has_unit(self) -> bool: ...  # whether `next_unit` would return one
    def next_unit(self) -> bytes | None: ...
    @property
    def lags(self) -> bool: ...  # whether the peer does not read what was sent
    def write_nowait(self, data: bytes) -> bool: ...
    async def send(self, *pieces: bytes) -> None: ...
    async def close(self) -> None: ...


Dispatch: TypeAlias = Callable[[str, tuple[object, ...], PeerT], object]
"""Answers one call: returns the value or what to await for it, or raises `Fault`; `HangUp` ends the
connection."""


@dataclass(eq=False, slots=True)
class CallLoop(Generic[PeerT]):
    _stream: ServedStream[PeerT]
    _dispatch: Dispatch[PeerT]
    _: KW_ONLY
    limit: InitVar[int]
    deadline: float
    idle: float | None
    compact: InitVar[bool] = True
    bound: Callable[[], int] | None = None
    urgent: bool = False
    _turns: LoopTurns = field(default_factory=of_loop, init=False)
    _loop: asyncio.AbstractEventLoop = field(default_factory=asyncio.get_running_loop, init=False)
    _calls: CallServer = field(init=False)
    _scope: asyncio.Timeout = field(init=False)
    _job: "asyncio.Future[Coroutine[Any, Any, None] | None]" = field(init=False)
    _idle_set: float = field(default=0.0, init=False)
    _deadline_timer: asyncio.TimerHandle | None = field(default=None, init=False)
    _value: Awaitable[object] | None = field(default=None, init=False)  # of the last call that takes time
    _busy: bool = field(default=False, init=False)  # a call is being answered, and no other may be taken
    _ended: bool = field(default=False, init=False)

    def __post_init__(self, limit: int, compact: bool) -> None:
        self._calls = CallServer(limit=limit, compact=compact)
        self._scope = asyncio.timeout(self.idle)
        self._job = self._loop.create_future()

    async def run(self) -> None:
        try:
            with contextlib.suppress(TimeoutError, RossecError):
                async with self._scope:
                    self._stream.on_ready(self._ready, self._take)
                    self._ready()
                    while (job := await self._job) is not None:
                        self._job = self._loop.create_future()
                        await job
                        self._answered()
                        self._loop.call_soon(self._ready)  # for units that arrived meanwhile, or the end
        finally:
            self._ended = True
            self._stream.on_ready(None)
            self._cancel_deadline()
            if self._job.done() and not self._job.cancelled() and self._job.exception() is None:
                waiting = self._job.result()
                if waiting is not None:  # it was not started
                    waiting.close()
            if isinstance(self._value, Coroutine):  # perhaps it was not started
                self._value.close()

    # -- one call

    def _ready(self) -> None:
        if self._is_free():
            self._answer_next(None)
        elif self._is_early():
            self._break_off()

    def _take(self, unit: bytes) -> bool:
        free = self._is_free()
        if free:
            self._answer_next(unit)
        elif self._calls.answering and not self._ended:
            self._break_off()
        return free

    def _is_free(self) -> bool:
        return not (self._busy or self._ended or self._job.cancelled())  # `run` was cancelled just now

    def _is_early(self) -> bool:
        return self._calls.answering and self._stream.has_unit and not self._ended

    def _break_off(self) -> None:
        self._end()
        if not self._scope.expired():
            self._scope.reschedule(self._loop.time())

    def _answer_next(self, unit: bytes | None) -> None:
        self._busy = True
        try:
            request = self._next_request(unit)
            if request is None:
                self._busy = False
            elif self._is_early():
                self._end()
            else:
                self._answer(request)
        except HttpRefused as error:
            self._wait_for(self._stream.send(self._calls.refuse(error.status)))
        except RossecError:  # closed by the peer, or not a unit: no answer
            self._end()
        except Exception as error:  # noqa: BLE001 - `run` raises it
            self._ended = True
            self._job.set_exception(error)

    def _next_request(self, unit: bytes | None) -> bytes | Oversized | None:
        # The next call; `unit`, if not None, follows everything buffered.
        calls, stream = self._calls, self._stream
        request = calls.take() if unit is None and calls.pending else None
        while request is None:
            if unit is None:
                unit = stream.next_unit()
            if unit is None:
                if calls.pending and self._deadline_timer is None:
                    self._deadline_timer = self._loop.call_later(self.deadline, self._end)
                return None
            request, unit = calls.take(unit), None
        if self._deadline_timer is not None:
            self._cancel_deadline()
        return request

    def _answer(self, request: bytes | Oversized) -> None:
        turns = self._turns
        # In turns: a megabyte takes some hundred milliseconds to parse (0047, attack `long-calls`).
        if isinstance(request, Oversized) or len(request) > AT_ONCE or not turns.has_time(self._source):
            steps = self._answer_steps(request)
            self._wait_for(self._respond_later(turns.run(self._source(), steps)))
            return
        began = monotonic()
        try:
            self._answer_at_once(request)
        finally:
            turns.spend(self._source, monotonic() - began)

    def _source(self) -> TurnOwner:
        return URGENT if self.urgent else source_of(self._stream.peer)

    def _answer_at_once(self, request: bytes) -> None:
        try:
            call = self._calls.load(request)
            value = self._dispatch(call.method, call.params, self._stream.peer)
            if type(value) is not list and isinstance(value, Awaitable):  # the isinstance check is slow
                self._value = value
                self._wait_for(self._respond_later(value))
                return
            message = self._calls.respond(value)
        except (HangUp, CompactRefused):
            raise
        except Exception as error:  # noqa: BLE001 - handled in `_failure`
            message = self._calls.respond(_failure(error))
        self._respond(message)

    def _answer_steps(
        self, request: bytes | Oversized
    ) -> Generator[None, None, "_Message | Awaitable[object]"]:
        bound = None if self.bound is None else self.bound()
        call = yield from self._calls.load_steps(request, bound)
        yield
        value = self._dispatch(call.method, call.params, self._stream.peer)
        if type(value) is not list and isinstance(value, Awaitable):
            self._value = value
            return value
        yield
        return _Message(self._calls.respond(value))

    def _respond(self, message: bytes) -> None:
        if self._stream.lags:
            self._wait_for(self._stream.send(message))
            return
        self._stream.write_nowait(message)
        self._answered()
        if self._calls.pending or self._stream.has_unit:
            self._loop.call_soon(self._ready)

    async def _respond_later(self, value: Awaitable[object]) -> None:
        try:
            found = await value
            if found is self._value and isinstance(found, Awaitable):
                found = await found
            message = found.data if isinstance(found, _Message) else self._calls.respond(found)
        except (HangUp, CompactRefused):
            raise
        except Exception as error:  # noqa: BLE001 - handled in `_failure`
            message = self._calls.respond(_failure(error))
        await self._stream.send(message)

    def _wait_for(self, job: Coroutine[Any, Any, None]) -> None:
        self._job.set_result(job)

    def _answered(self) -> None:
        self._busy = False
        if self._calls.closing:
            self._end()
        # Restart the idle time-out: not for each call, as a timer can cost more than the call.
        elif self.idle is not None and (now := self._loop.time()) > self._idle_set + self.idle / 64:
            self._idle_set = now
            self._scope.reschedule(now + self.idle)

    # -- time and ends

    def _cancel_deadline(self) -> None:
        if self._deadline_timer is not None:
            self._deadline_timer.cancel()
            self._deadline_timer = None

    def _end(self) -> None:
        if not self._ended:
            self._ended = True
            if not self._job.done():
                self._job.set_result(None)


def _failure(error: Exception) -> Fault:
    # A bug must neither end the other calls nor reveal internals to the peer.
    if isinstance(error, XmlRpcRefused):
        return Fault(FAULT_CODE, str(error))
    if isinstance(error, Fault):
        return error
    _log.error("a call failed with an internal error", exc_info=error)
    return _CRASHED


class Stream(Protocol):
    async def send(self, *pieces: bytes) -> None: ...
    async def receive(self) -> bytes: ...
    async def close(self) -> None: ...


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
        stream,
        dispatch,
        limit=limit,
        deadline=request_deadline,
        idle=idle_deadline,
        compact=compact,
        bound=bound,
        urgent=urgent,
    )
    try:
        await calls.run()
    finally:
        await stream.close()


class RpcClient:
    """Calls methods of the peer at the other end of a stream, one at a time. After a failed call (deadline,
    protocol error) the stream is closed: a late answer must not be taken for the answer to the next call."""

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
        self.closed = False

    @property
    def is_compact(self) -> bool:
        return self._calls.is_compact

    async def call(self, method: str, *params: object) -> object:
        answer = await self._answer(method, params)
        if isinstance(answer, Encoded) and len(answer.body) > AT_ONCE:
            return await of_loop().run(self._source, value_steps(answer, self._limit))
        return value_in(answer, self._limit)

    async def fetch(self, method: str, *params: object) -> bytes:
        """Like `call`, but the body of an XML-RPC response, unparsed if it came so."""
        return body_of(await self._answer(method, params))

    async def ask(self, method: str, *params: object) -> object:
        """Like `call`, for ROS methods: the value in `[1, status, value]`."""
        return xmlrpc.value_of(await self.call(method, *params))

    async def close(self) -> None:
        self.closed = True
        await self._stream.close()

    async def _answer(self, method: str, params: tuple[object, ...]) -> object:
        async with self._turn:
            if self.closed:
                raise CallFailed(f"{method}: the connection is closed")
            request = self._calls.request(method, params)
            if len(request) > BODY_LIMIT:
                self._calls.take_back()
                raise XmlRpcRefused(f"a call of {len(request)} bytes, at most {BODY_LIMIT} are sent")
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
            if not complete:  # a late answer would be taken for the answer to the next call
                self.closed = True
                with contextlib.suppress(RossecError):
                    await self._stream.close()
        return answer

    async def _take(self, data: bytes) -> object:
        if len(data) <= AT_ONCE:
            return self._calls.take(data)
        return await of_loop().run(self._source, self._calls.take_steps(data))
