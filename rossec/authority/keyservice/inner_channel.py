"""The socketpair between the service and its network process, as calls in both directions. A shell.

A side that breaks the protocol ends the connection, and with it the face: the service starts a new one.
"""

import asyncio
import itertools
import logging
import socket
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import Final

from ca.encoding import Value
from ca.errors import HintedError
from rossec.authority.keyservice import messages
from rossec.authority.keyservice.messages import InnerAnswer, InnerRefusal, InnerRequest
from rossec.errors import KeyMessageRefused, KeyServiceRefused
from rossec.host import runner, workers

MAX_REQUESTS: Final = 512  # of the other side at a time; a join port has 256 sessions
_FAILED: Final = "the other process could not do it", "its log says why"
_ENDED: Final = "the network process of the authority's service has ended"
_log = logging.getLogger("rossec.authority.service")

Handler = Callable[..., Awaitable[Value]]


class InnerChannel:
    """`sock`: the end of the socketpair. `handlers`: what the other side may ask; called with the arguments
    of the operation. Raise `HintedError` to refuse. `limit`: bytes of a message from the other side.
    """

    def __init__(self, sock: socket.socket, handlers: Mapping[str, Handler], limit: int) -> None:
        self._socket = sock
        self._handlers = handlers
        self._limit = limit
        self._numbers = itertools.count()
        self._waiting: dict[int, asyncio.Future[Value]] = {}
        self._tasks = runner.TaskSet()
        self._writer: asyncio.StreamWriter | None = None
        self._connected = asyncio.Event()

    async def run(self) -> None:
        reader, self._writer = await asyncio.open_connection(sock=self._socket)
        self._connected.set()
        try:
            while True:
                body = await workers.read_frame(reader, partial(messages.frame_size, limit=self._limit))
                self._take(messages.read(body, self._limit))
        except (asyncio.IncompleteReadError, ConnectionError):
            return
        finally:
            self._writer.transport.abort()
            self._writer = None
            for future in self._waiting.values():
                if not future.done():
                    future.set_exception(KeyServiceRefused(_ENDED, "it is started again"))
            await self._tasks.close()

    async def call(self, operation: str, *arguments: Value, within: float) -> Value:
        await self._connected.wait()
        if self._writer is None:
            raise KeyServiceRefused(_ENDED, "it is started again")
        number = next(self._numbers) % messages.MAX_NUMBER
        frame = messages.write(InnerRequest(number, operation, arguments))
        answer: asyncio.Future[Value] = asyncio.get_running_loop().create_future()
        self._waiting[number] = answer  # taken out below, also where this is cancelled
        try:
            async with asyncio.timeout(within):
                self._writer.write(frame)
                await self._writer.drain()
                return await answer
        except ConnectionError as error:
            raise KeyServiceRefused(_ENDED, "it is started again") from error
        finally:
            del self._waiting[number]

    def _take(self, message: messages.InnerMessage) -> None:
        if isinstance(message, InnerRequest):
            # Bounded, and of the table (`face-takeover`): a face that was taken over asks for no more.
            if message.operation not in self._handlers or len(self._tasks) >= MAX_REQUESTS:
                raise KeyMessageRefused(f"a request {message.operation} that may not be made now")
            self._tasks.spawn(self._carry_out(message), name=message.operation)
            return
        future = self._waiting.get(message.number)  # None: it was given up
        if future is None or future.done():
            return
        if isinstance(message, InnerRefusal):
            future.set_exception(KeyServiceRefused(message.message, message.hint))
        else:
            future.set_result(message.value)

    async def _carry_out(self, request: InnerRequest) -> None:
        try:
            value = await self._handlers[request.operation](*request.arguments)
            frame = messages.write(InnerAnswer(request.number, value))
        except HintedError as error:
            frame = messages.write(InnerRefusal(request.number, str(error), error.hint))
        except Exception:  # noqa: BLE001 - the other side would wait for an answer
            _log.exception("a request %s of the other process failed", request.operation)
            frame = messages.write(InnerRefusal(request.number, *_FAILED))
        if self._writer is not None:
            self._writer.write(frame)
            await self._writer.drain()
