"""The calls of a service as they pass a connection of rospy's: whole frames, each judged anew.

Pure. rospy reads and writes bytes; between it and the connection a request is one frame, bounded
before it is buffered, and passes only while the caller's right lasts. Where a grant restricts the
right, requests and responses are treated as in the built-in node
(`rossec.participant.service_guard`): what is not allowed never reaches the program, and the other
side hears why.
"""

from collections.abc import Callable
from typing import Final, Protocol

from ca.errors import HintedError
from rossec.channel.records import Bytes, ChannelLimits
from rossec.errors import ChannelClosed
from rossec.participant.service_guard import ServiceGuard
from rossec.ros import service as wire
from rossec.ros.framing import Framing
from rossec.ros.header import FrameReader

_LIMIT: Final = ChannelLimits.unit
_OK: Final = b"\1"
_LENGTH: Final = 4

Pieces = tuple[Bytes, ...]


class ServiceFilter(Protocol):
    """One side of a service's connection; `framing` knows whether a call has been begun."""

    framing: Framing

    def incoming(self, data: bytes) -> tuple[bytes, Pieces]:
        """What arrived: the program may read the first, the peer is sent the second.

        Raises:
            HintedError: the connection must end.
        """

    def outgoing(self, data: bytes) -> Pieces:
        """What the program sends, as it may be sent.

        Raises:
            HintedError: it may not.
        """


class ServerFilter:
    """The provider's side.

    Args:
        termination_reason: why the caller must be cut now, if it must.
        guard: what its grant restricts; None: nothing.
        refused: is told what was not allowed.
        limit: how long a request may be.
    """

    def __init__(
        self,
        termination_reason: Callable[[], str | None],
        guard: ServiceGuard | None,
        refused: Callable[[HintedError], None],
        now: Callable[[], int],
        limit: int = _LIMIT,
    ) -> None:
        self.framing = Framing(FrameReader(limit))
        self._termination_reason = termination_reason
        self._guard = guard
        self._refused = refused
        self._now = now

    def incoming(self, data: bytes) -> tuple[bytes, Pieces]:
        """As of `ServiceFilter`: a request."""
        request = self.framing.feed_one(data, self._now())
        if request is None:
            return b"", ()
        reason = self._termination_reason()
        if reason is not None:
            raise ChannelClosed(reason)
        if self._guard is None:
            return b"".join(wire.framed([request])), ()
        try:
            return b"".join(wire.framed(self._guard.request(request, self._now()))), ()
        except HintedError as error:
            return b"", self._refusal(error)

    def outgoing(self, data: bytes) -> Pieces:
        """As of `ServiceFilter`: a response. What the guard refuses is a failure of the call."""
        if self._guard is None or data[:1] != _OK:
            return (data,)
        response = memoryview(data)[len(_OK) + _LENGTH :]
        try:
            return tuple(wire.success(self._guard.response(response, self._now())))
        except HintedError as error:
            return self._refusal(error)

    def _refusal(self, error: HintedError) -> Pieces:
        self._refused(error)
        return tuple(wire.failure(f"rossec: {error}"))


class ClientFilter:
    """The caller's side, where the provider's grant restricts what may be asked and answered."""

    def __init__(self, guard: ServiceGuard, now: Callable[[], int], limit: int = _LIMIT) -> None:
        self.framing = Framing(FrameReader(limit, lead=len(_OK)))
        self._guard = guard
        self._now = now

    def incoming(self, data: bytes) -> tuple[bytes, Pieces]:
        """As in `ServiceFilter`: a response. A refused one is a failure of the call."""
        content = self.framing.feed_one(data, self._now())
        if content is None:
            return b"", ()
        mark, response = content[: len(_OK)], content[len(_OK) :]
        if mark != _OK:
            return b"".join((mark, *wire.framed([response]))), ()
        try:
            return b"".join(wire.success(self._guard.response(response, self._now()))), ()
        except HintedError as error:
            return b"".join(wire.failure(f"rossec: {error}")), ()

    def outgoing(self, data: bytes) -> Pieces:
        """As of `ServiceFilter`: a request."""
        request = memoryview(data)[_LENGTH:]
        return tuple(wire.framed(self._guard.request(request, self._now())))
