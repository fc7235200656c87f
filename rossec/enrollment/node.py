"""A node that waits to be enrolled: its listening port, open to all, and the person who confirms.

Callers are unauthenticated: a limited number at a time, each with a deadline; a message that is
refused ends its connection, and is reported to the person in one line. Callers whose offer was
answered stay connected for the result.
"""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Final, Self

from ca.enrollment.messages import MAX_MESSAGE, Abort, Delivery, Reason, read, write
from ca.enrollment.node import NodeEnrollment, NodeState, Pending
from ca.errors import (
    ConflictingOffer,
    EnrollmentExpired,
    EnrollmentLocked,
    EnrollmentOver,
    EnrollmentRefused,
)
from rossec.enrollment import wire
from rossec.net.aio.server import bind
from rossec.net.aio.tasks import TaskSet
from rossec.net.halfopen import HalfOpen, HalfOpenCount, HalfOpenSlot
from rossec.ros.text import printable

PATIENCE: Final = 10.0  # seconds without a message from a caller
_CLOSE_TIMEOUT: Final = 5.0
_CAPS: Final = HalfOpen(per_address=4, total=16)
_REASONS: Final[dict[type[EnrollmentRefused], Reason]] = {
    ConflictingOffer: Reason.CONFLICT,
    EnrollmentOver: Reason.OVER,
    EnrollmentExpired: Reason.OVER,
    EnrollmentLocked: Reason.OVER,
}


class WaitingNode:
    """One enrollment of one node, on the network."""

    def __init__(
        self,
        core: NodeEnrollment,
        clock: Callable[[], int],
        on_refusal: Callable[[str], None],
        patience: float = PATIENCE,
    ) -> None:
        """`on_refusal` is called with each refusal as one printable line."""
        self.core = core
        self.port = 0
        self._clock = clock
        self._on_refusal = on_refusal
        self._patience = patience
        self._servers: list[asyncio.Server] = []
        self._callers = HalfOpenCount(_CAPS)
        self._waiting: set[asyncio.StreamWriter] = set()
        self._tasks = TaskSet()
        self._changed = asyncio.Event()

    async def listen(self, host: str | None, port: int) -> None:
        """Serve on `host` (None: every address) and `port` (0: any free one).

        Raises:
            OSError: not an address of this host, or the port is taken.
        """
        for sock in bind(host, port):
            server = await asyncio.start_server(self._accept, sock=sock, limit=MAX_MESSAGE)
            self._servers.append(server)
            self.port = sock.getsockname()[1]

    async def until(self, *states: NodeState, every: Callable[[int], None]) -> None:
        """Wait for one of `states`; `every` is called each second with the seconds left.

        Raises:
            EnrollmentRefused: it ended in another state; the reason.
        """
        while self.core.state not in states:
            if self.core.end_reason is not None:
                raise self.core.end_reason
            every(self.core.expires - self._clock())
            with suppress(TimeoutError):
                async with asyncio.timeout(1):
                    await self._changed.wait()
            self._changed.clear()
            self.core.tick(self._clock())

    def confirm(self, digits: str, activate: Callable[[Pending], None]) -> None:
        """A person confirmed: `activate` writes the identity, then the authority is notified.

        Raises:
            EnrollmentRefused: the digits are wrong, or there is nothing to confirm.
        """
        try:
            pending = self.core.confirm(digits, self._clock())
            activate(pending)
        except BaseException as error:
            if self.core.state is NodeState.CONFIRMED:
                self.core.stop(EnrollmentOver(f"the identity could not be written: {error}"))
            self._state_changed()
            raise
        self._send_all(self.core.activated())
        self._changed.set()

    def stop(self, why: EnrollmentRefused) -> None:
        """End it without an identity, and notify the authority."""
        self.core.stop(why)
        self._state_changed()

    async def close(self) -> None:
        """Stop listening; callers that wait for the result get it."""
        for server in self._servers:
            server.close()
        leaving = [*self._waiting]
        for writer in leaving:
            writer.close()
        for writer in leaving:
            with suppress(OSError, TimeoutError):
                async with asyncio.timeout(_CLOSE_TIMEOUT):
                    await writer.wait_closed()
        await self._tasks.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        peer = writer.get_extra_info("peername")  # None: closed already
        address = "" if peer is None else str(peer[0])
        slot = None if peer is None else self._callers.admit(address)
        if slot is None:
            writer.transport.abort()
            return
        self._tasks.spawn(
            self._serve_counted(reader, writer, address, slot), name=f"caller {address}"
        )

    async def _serve_counted(
        self,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        address: str,
        slot: HalfOpenSlot,
    ) -> None:
        """A caller counts until its socket is closed; a lingering one is evicted first."""
        slot.close = writer.transport.abort
        try:
            await self._serve(reader, writer, address)
            slot.linger()
            with suppress(OSError, TimeoutError):
                async with asyncio.timeout(_CLOSE_TIMEOUT):
                    await writer.wait_closed()
        finally:
            writer.transport.abort()
            slot.release()

    async def _serve(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, address: str
    ) -> None:
        try:
            while True:
                async with asyncio.timeout(self._wait_for(writer)):
                    data = await wire.receive(reader)
                self._answer(writer, data)
                async with asyncio.timeout(
                    self._patience
                ):  # a caller that does not read is not written to
                    await writer.drain()
        except EnrollmentRefused as error:
            self._on_refusal(printable(f"{address}: {error}"))
            wire.send(writer, _abort(error))
        except TimeoutError:
            writer.transport.abort()  # close() would wait for a caller that does not read
        except (OSError, EOFError):
            pass  # the caller may connect again
        finally:
            self._waiting.discard(writer)
            writer.close()

    def _wait_for(self, writer: asyncio.StreamWriter) -> float:
        if writer in self._waiting:
            return max(1, self.core.expires - self._clock() + 1)
        return self._patience

    def _answer(self, writer: asyncio.StreamWriter, data: bytes) -> None:
        before = self.core.state
        try:
            answers = self.core.receive(data, self._clock())
        finally:
            if self.core.state is not before:
                self._state_changed()
        for answer in answers:
            wire.send(writer, answer)
        if not isinstance(read(answers[0]), Delivery):
            self._waiting.add(writer)

    def _state_changed(self) -> None:
        """Wake `until`; if it is over, notify the waiting callers."""
        self._changed.set()
        if self.core.state is NodeState.OVER and self.core.end_reason is not None:
            self._send_all([_abort(self.core.end_reason)])

    def _send_all(self, messages: list[bytes]) -> None:
        for writer in self._waiting:
            for message in messages:
                wire.send(writer, message)


def _abort(error: EnrollmentRefused) -> bytes:
    return write(Abort(_REASONS.get(type(error), Reason.REFUSED)))
