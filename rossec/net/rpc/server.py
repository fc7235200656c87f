"""One connection on which calls are answered: from the unit to the answer within one callback.

Both forms of a call (`rossec.ros.callserver`) go to the same dispatcher.
A call whose value is available at once costs no task switch, no timer and no turn of the loop;
`run` awaits what takes time (an awaitable value, a peer that does not read). One call is answered
in each turn of the loop, so that one peer with many calls cannot keep the others waiting. A long
one is parsed and answered in the turns of its peer (`rossec.net.rpc.turns`), as is a short one when
others of this pass of the loop took long, and one that is too long for what the peer has shown is
answered with a fault, unparsed.
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable, Coroutine, Generator
from time import monotonic
from typing import Any, Final, Generic, NamedTuple, Protocol, TypeVar

from rossec.errors import CompactRefused, HangUp, HttpRefused, RossecError, XmlRpcRefused
from rossec.net.rpc.turns import AT_ONCE, URGENT, TurnOwner, of_loop, source_of
from rossec.ros.callserver import CallServer
from rossec.ros.httpread import Oversized
from rossec.ros.xmlrpc import FAULT_CODE, Fault

_CRASHED: Final = Fault(FAULT_CODE, "rossec: internal error")

_log = logging.getLogger("rossec.net.callloop")
PeerT = TypeVar("PeerT")
PeerT_co = TypeVar("PeerT_co", covariant=True)
PeerT_contra = TypeVar("PeerT_contra", contravariant=True)


class _Message(NamedTuple):
    """The bytes of an answer."""

    data: bytes


class ServedStream(Protocol[PeerT_co]):
    """What is used of `rossec.net.aio.SecureStream`."""

    @property
    def peer(self) -> PeerT_co:
        """The authenticated identity at the other end."""

    def on_ready(
        self, callback: Callable[[], None] | None, take: Callable[[bytes], bool] | None = None
    ) -> None:
        """Call back, not at once, whenever `next_unit` has a new result.

        `take` may be offered a unit at once instead; it returns whether it took it.
        """

    @property
    def has_unit(self) -> bool:
        """Whether `next_unit` would return one."""

    def next_unit(self) -> bytes | None:
        """The next unit, if it has arrived. Raises a `RossecError` after the end."""

    @property
    def lags(self) -> bool:
        """Whether the peer does not read what was sent."""

    def write_nowait(self, data: bytes) -> bool:
        """Send one unit at once."""

    async def send(self, *pieces: bytes) -> None:
        """Send one unit."""

    async def close(self) -> None:
        """Close in order."""


class Dispatch(Protocol[PeerT_contra]):
    """Answers one call: returns the value or what to await for it, or raises `Fault`.

    `HangUp` ends the connection.
    """

    def __call__(self, method: str, params: tuple[object, ...], peer: PeerT_contra, /) -> object:
        """The value to answer with."""


class CallLoop(Generic[PeerT]):
    """Serves one stream; see `rossec.net.rpc.client.serve_calls`."""

    __slots__ = (
        "_bound",
        "_busy",
        "_calls",
        "_deadline",
        "_deadline_timer",
        "_dispatch",
        "_ended",
        "_idle",
        "_idle_set",
        "_job",
        "_loop",
        "_scope",
        "_stream",
        "_turns",
        "_urgent",
        "_value",
    )  # fmt: skip

    def __init__(
        self,
        stream: ServedStream[PeerT],
        dispatch: Dispatch[PeerT],
        *,
        limit: int,
        deadline: float,
        idle: float | None,
        compact: bool = True,
        bound: Callable[[], int] | None = None,
        urgent: bool = False,
    ) -> None:
        self._stream = stream
        self._bound = bound
        self._urgent = urgent
        self._turns = of_loop()
        self._dispatch = dispatch
        self._calls = CallServer(limit=limit, compact=compact)
        self._deadline = deadline
        self._idle = idle
        self._loop = asyncio.get_running_loop()
        self._scope = asyncio.timeout(idle)
        self._idle_set = 0.0
        self._deadline_timer: asyncio.TimerHandle | None = None
        self._job: asyncio.Future[Coroutine[Any, Any, None] | None] = self._loop.create_future()
        self._value: Awaitable[object] | None = None  # of the last call whose value takes time
        self._busy = False  # a call is being answered, and no other may be taken
        self._ended = False

    async def run(self) -> None:
        """Serve until the peer closes or breaks the protocol; raises what crashed."""
        try:
            with contextlib.suppress(TimeoutError, RossecError):
                async with self._scope:
                    self._stream.on_ready(self._ready, self._take)
                    self._ready()
                    while (job := await self._job) is not None:
                        self._job = self._loop.create_future()
                        await job
                        self._answered()
                        self._loop.call_soon(
                            self._ready
                        )  # for units that arrived meanwhile, or the end
        finally:
            self._close()

    def _close(self) -> None:
        self._ended = True
        self._stream.on_ready(None)
        self._cancel_deadline()
        if self._job.done() and not self._job.cancelled() and self._job.exception() is None:
            job = self._job.result()
            if job is not None:  # it was not started
                job.close()
        if isinstance(self._value, Coroutine):  # perhaps it was not started
            self._value.close()

    # -- one call

    def _ready(self) -> None:
        """Answer one call if there is one."""
        if self._is_free():
            self._answer_next(None)
        elif self._is_early():
            self._break_off()

    def _take(self, unit: bytes) -> bool:
        """The fast path: answer the call that has just arrived."""
        free = self._is_free()
        if free:
            self._answer_next(unit)
        elif self._calls.answering and not self._ended:
            self._break_off()
        return free

    def _is_free(self) -> bool:
        return not (
            self._busy or self._ended or self._job.cancelled()
        )  # `run` was cancelled just now

    def _is_early(self) -> bool:
        """Whether a unit arrived before the answer to the last call."""
        return self._calls.answering and self._stream.has_unit and not self._ended

    def _break_off(self) -> None:
        """End the connection, also a call whose value takes time."""
        self._end()
        if not self._scope.expired():
            self._scope.reschedule(self._loop.time())

    def _answer_next(self, unit: bytes | None) -> None:
        """Answer the next call; any error here ends the connection."""
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
        """The next call; `unit`, if not None, follows everything buffered."""
        calls, stream = self._calls, self._stream
        request = calls.take() if unit is None and calls.pending else None
        while request is None:
            if unit is None:
                unit = stream.next_unit()
            if unit is None:
                if calls.pending and self._deadline_timer is None:
                    self._deadline_timer = self._loop.call_later(self._deadline, self._end)
                return None
            request, unit = calls.take(unit), None
        if self._deadline_timer is not None:
            self._cancel_deadline()
        return request

    def _answer(self, request: bytes | Oversized) -> None:
        turns = self._turns
        if (
            isinstance(request, Oversized)
            or len(request) > AT_ONCE
            or not turns.has_time(self._source)
        ):
            steps = self._answer_steps(request)
            self._wait_for(self._respond_later(turns.run(self._source(), steps)))
            return
        began = monotonic()
        try:
            self._answer_at_once(request)
        finally:
            turns.spend(self._source, monotonic() - began)

    def _source(self) -> TurnOwner:
        return URGENT if self._urgent else source_of(self._stream.peer)

    def _answer_at_once(self, request: bytes) -> None:
        try:
            call = self._calls.load(request)
            value = self._dispatch(call.method, call.params, self._stream.peer)
            if type(value) is not list and isinstance(
                value, Awaitable
            ):  # the isinstance check is slow
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
        """The bytes of the answer to a call, or what to await for its value."""
        bound = None if self._bound is None else self._bound()
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
        else:
            self._restart_idle()

    # -- time and ends

    def _restart_idle(self) -> None:
        """Restart the idle time-out: not for each call, as a timer can cost more than the call."""
        if self._idle is not None and (now := self._loop.time()) > self._idle_set + self._idle / 64:
            self._idle_set = now
            self._scope.reschedule(now + self._idle)

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
    """A bug must neither end the other calls nor reveal internals to the peer."""
    if isinstance(error, XmlRpcRefused):
        return Fault(FAULT_CODE, str(error))
    if isinstance(error, Fault):
        return error
    _log.error("a call failed with an internal error", exc_info=error)
    return _CRASHED
