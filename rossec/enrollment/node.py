"""A node that waits to be enrolled: its listening port, open to all, and the person who confirms.

Callers are unauthenticated: a limited number at a time, each with a deadline; a message that is
refused ends its connection, and is reported to the person in one line. Callers whose offer was
answered stay connected for the result.
"""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Final, Self

from ca.enrollment.messages import Abort, Delivery, Reason, read, write
from ca.enrollment.node import NodeEnrollment, NodeState, Pending
from ca.errors import (
    ConflictingOffer,
    EnrollmentExpired,
    EnrollmentLocked,
    EnrollmentOver,
    EnrollmentRefused,
)
from rossec.enrollment import wire
from rossec.enrollment.session_server import SessionServer, wait_closed
from rossec.net.halfopen import HalfOpen
from rossec.ros.text import printable

PATIENCE: Final = 10.0  # seconds without a message from a caller
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
        self._clock = clock
        self._on_refusal = on_refusal
        self._patience = patience
        self.server = SessionServer(self._serve, _CAPS)
        self._waiting: set[asyncio.StreamWriter] = set()
        self._changed = asyncio.Event()

    @property
    def port(self) -> int:
        """The port it listens on."""
        return self.server.port

    async def listen(self, host: str | None, port: int) -> None:
        """As `SessionServer.listen`."""
        await self.server.listen(host, port)

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
        self.server.stop_listening()
        leaving = [*self._waiting]
        for writer in leaving:
            writer.close()
        for writer in leaving:
            await wait_closed(writer)
        await self.server.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

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
