"""One connection on which calls are answered: from the unit to the answer within one callback.

A call whose value is available at once costs no task switch, no timer and no turn of the loop;
`run` awaits what takes time (an awaitable value, a peer that does not read). One call is answered
in each turn of the loop, so that one peer with many calls cannot keep the others waiting.
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, Final, Generic, Protocol, TypeVar

from rossec.errors import HangUp, HttpRefused, RossecError, XmlRpcRefused
from rossec.ros import xmlrpc
from rossec.ros.http import HttpServer
from rossec.ros.xmlrpc import Fault

_FAULT_CODE: Final = 1  # the only one stock ROS uses
_CRASHED: Final = Fault(_FAULT_CODE, "rossec: internal error")

_log = logging.getLogger("rossec.net.callloop")
PeerT = TypeVar("PeerT")
PeerT_co = TypeVar("PeerT_co", covariant=True)
PeerT_contra = TypeVar("PeerT_contra", contravariant=True)


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
        "_busy",
        "_deadline",
        "_deadline_timer",
        "_dispatch",
        "_ended",
        "_http",
        "_idle",
        "_idle_set",
        "_job",
        "_limit",
        "_loop",
        "_scope",
        "_stream",
        "_value",
    )  # fmt: skip  # fmt: skip

    def __init__(
        self,
        stream: ServedStream[PeerT],
        dispatch: Dispatch[PeerT],
        *,
        limit: int,
        deadline: float,
        idle: float | None,
    ) -> None:
        self._stream = stream
        self._dispatch = dispatch
        self._http = HttpServer(limit=limit)
        self._limit = limit
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
            if job is not None:  # neither was started, nor its awaitable
                job.close()
                if isinstance(self._value, Coroutine):
                    self._value.close()

    # -- one call

    def _ready(self) -> None:
        """Answer one call if there is one."""
        if self._is_free():
            self._answer_next(None)

    def _take(self, unit: bytes) -> bool:
        """The fast path: answer the call that has just arrived."""
        free = self._is_free()
        if free:
            self._answer_next(unit)
        return free

    def _is_free(self) -> bool:
        return not (
            self._busy or self._ended or self._job.cancelled()
        )  # `run` was cancelled just now

    def _answer_next(self, unit: bytes | None) -> None:
        """Answer the next call; any error here ends the connection."""
        self._busy = True
        try:
            body = self._next_request(unit)
            if body is None:
                self._busy = False
            else:
                self._answer(body)
        except HttpRefused as error:
            self._wait_for(self._stream.send(self._http.refuse(error.status)))
        except RossecError:  # closed by the peer: no answer
            self._end()
        except Exception as error:  # noqa: BLE001 - `run` raises it
            self._ended = True
            self._job.set_exception(error)

    def _next_request(self, unit: bytes | None) -> bytes | None:
        """The body of the next call; `unit`, if not None, follows everything buffered."""
        http, stream = self._http, self._stream
        body = http.next_request() if unit is None and http.pending else None
        while body is None:
            if unit is None:
                unit = stream.next_unit()
            if unit is None:
                if http.pending and self._deadline_timer is None:
                    self._deadline_timer = self._loop.call_later(self._deadline, self._end)
                return None
            body, unit = http.feed_whole(unit), None
        if self._deadline_timer is not None:
            self._cancel_deadline()
        return body

    def _answer(self, body: bytes) -> None:
        try:
            call = xmlrpc.load_call(body, limit=self._limit)
            value = self._dispatch(call.method, call.params, self._stream.peer)
            if type(value) is not list and isinstance(
                value, Awaitable
            ):  # the isinstance check is slow
                self._value = value
                self._wait_for(self._respond_later(value))
                return
            response = self._encoded(value)
        except HangUp:
            raise
        except Exception as error:  # noqa: BLE001 - handled in `_failure`
            response = _failure(error)
        self._respond(response)

    def _encoded(self, value: object) -> bytes:
        """The response, unless it is longer than peers accept."""
        response = xmlrpc.dump_response(value)
        if len(response) > self._limit:
            raise Fault(
                _FAULT_CODE,
                f"rossec: the answer has {len(response)} bytes, at most {self._limit} are sent: "
                "ask for less at a time",
            )
        return response

    def _respond(self, response: bytes) -> None:
        message = self._http.respond(response)
        if self._stream.lags:
            self._wait_for(self._stream.send(message))
            return
        self._stream.write_nowait(message)
        self._answered()
        if self._http.pending or self._stream.has_unit:
            self._loop.call_soon(self._ready)

    async def _respond_later(self, value: Awaitable[object]) -> None:
        try:
            response = self._encoded(await value)
        except HangUp:
            raise
        except Exception as error:  # noqa: BLE001 - handled in `_failure`
            response = _failure(error)
        await self._stream.send(self._http.respond(response))

    def _wait_for(self, job: Coroutine[Any, Any, None]) -> None:
        self._job.set_result(job)

    def _answered(self) -> None:
        self._busy = False
        if self._http.closing:
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


def _failure(error: Exception) -> bytes:
    """A bug must neither end the other calls nor reveal internals to the peer."""
    if isinstance(error, XmlRpcRefused):
        return xmlrpc.dump_response(Fault(_FAULT_CODE, str(error)))
    if isinstance(error, Fault):
        return xmlrpc.dump_response(error)
    _log.error("a call failed with an internal error", exc_info=error)
    return xmlrpc.dump_response(_CRASHED)
