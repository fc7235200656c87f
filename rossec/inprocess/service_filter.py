"""Filters the calls of a service on a connection of rospy's: whole frames, each authorized.

Pure. rospy reads and writes bytes; here a request is one frame, bounded before it is buffered, and
forwarded only while the caller's right lasts. Where a grant restricts the right, requests and
responses are filtered as in the built-in node (`rossec.participant.service_guard`): what is not
allowed never reaches the program, and the other side gets the reason.
"""

from collections.abc import Callable
from typing import Final, Protocol

from ca.errors import HintedError
from rossec.channel.records import Bytes
from rossec.participant.service_guard import ServiceGuard
from rossec.ros import service as wire
from rossec.ros.framing import Framing
from rossec.ros.header import MESSAGE_LIMIT, FrameReader

_OK: Final = b"\1"
_LENGTH: Final = 4

Pieces = tuple[Bytes, ...]


class ServiceFilter(Protocol):
    """One side of a service's connection; `framing` knows whether a call has begun."""

    framing: Framing

    def incoming(self, data: bytes) -> tuple[bytes, Pieces]:
        """For received data: what the program may read, and what to answer the peer.

        Raises:
            HintedError: the connection must end.
        """

    def replace_guard(self, guard: ServiceGuard | None) -> None:
        """Apply another guard from the next message on."""

    def outgoing(self, data: bytes) -> Pieces:
        """What the program sends, as it may be sent.

        Raises:
            HintedError: it may not be sent.
        """


class ServerFilter:
    """The provider's side.

    Args:
        check: raises when the connection must be closed now.
        guard: applies the restrictions of its grant; None: there are none.
        on_refusal: called with the error for each refusal.
        limit: the most bytes a request may have.
    """

    def __init__(
        self,
        check: Callable[[], None],
        guard: ServiceGuard | None,
        on_refusal: Callable[[HintedError], None],
        now: Callable[[], float],
        limit: int = MESSAGE_LIMIT,
    ) -> None:
        self.framing = Framing(FrameReader(limit))
        self._check = check
        self._guard = guard
        self._on_refusal = on_refusal
        self._now = now

    def replace_guard(self, guard: ServiceGuard | None) -> None:
        """See `ServiceFilter`."""
        self._guard = guard

    def incoming(self, data: bytes) -> tuple[bytes, Pieces]:
        """See `ServiceFilter`: a request."""
        request = self.framing.feed_one(data, int(self._now()))
        if request is None:
            return b"", ()
        self._check()
        guard = self._guard
        if guard is None:
            return b"".join(wire.framed([request])), ()
        try:
            return b"".join(wire.framed(guard.request(request, self._now()))), ()
        except HintedError as error:
            return b"", self._refusal(error)

    def outgoing(self, data: bytes) -> Pieces:
        """See `ServiceFilter`: a response. A response the guard refuses fails the call."""
        guard = self._guard
        if guard is None or data[:1] != _OK:
            return (data,)
        response = memoryview(data)[len(_OK) + _LENGTH :]
        try:
            return tuple(wire.success(guard.response(response, self._now())))
        except HintedError as error:
            return self._refusal(error)

    def _refusal(self, error: HintedError) -> Pieces:
        self._on_refusal(error)
        return tuple(wire.failure(f"rossec: {error}"))


class ClientFilter:
    """The caller's side, where the provider's grant restricts requests and responses."""

    def __init__(
        self, guard: ServiceGuard | None, now: Callable[[], float], limit: int = MESSAGE_LIMIT
    ) -> None:
        self.framing = Framing(FrameReader(limit, lead=len(_OK)))
        self._guard = guard
        self._now = now

    def replace_guard(self, guard: ServiceGuard | None) -> None:
        """See `ServiceFilter`."""
        self._guard = guard

    def incoming(self, data: bytes) -> tuple[bytes, Pieces]:
        """See `ServiceFilter`: a response. A refused one fails the call."""
        content = self.framing.feed_one(data, int(self._now()))
        if content is None:
            return b"", ()
        mark, response = content[: len(_OK)], content[len(_OK) :]
        guard = self._guard
        if mark != _OK or guard is None:
            return b"".join((mark, *wire.framed([response]))), ()
        try:
            return b"".join(wire.success(guard.response(response, self._now()))), ()
        except HintedError as error:
            return b"".join(wire.failure(f"rossec: {error}")), ()

    def outgoing(self, data: bytes) -> Pieces:
        """See `ServiceFilter`: a request."""
        guard = self._guard
        if guard is None:
            return (data,)
        request = memoryview(data)[_LENGTH:]
        return tuple(wire.framed(guard.request(request, self._now())))
