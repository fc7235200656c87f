"""Connections that others made: half open at first, then each with a task of its own.

Unauthenticated peers cost a bounded amount: the unfinished handshakes from one address and in total
are limited, each has one deadline. A handler ends with its connection: a crash is logged and closes
that connection only.
"""

import asyncio
import logging
from collections.abc import Awaitable, Callable
from functools import partial
from types import TracebackType
from typing import Final, Generic, Self, TypeAlias

from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.opening import WireProtocol
from rossec.errors import ChannelError, PlainPeer
from rossec.net.aio.stream import SecureStream
from rossec.net.aio.tasks import TaskSet
from rossec.net.aio.transport import ByteTransport, TransportOwner
from rossec.net.context import SecureContext
from rossec.net.halfopen import HalfOpenSlot

_log = logging.getLogger("rossec.net.server")
_REPORT_EVERY: Final = 10.0

Handler: TypeAlias = Callable[[SecureStream[PeerT]], Awaitable[None]]


class AcceptedStreams(Generic[PeerT]):
    """Connections and their handlers: the base of what listens, on a port or in a mailbox."""

    def __init__(
        self,
        handler: Handler[PeerT],
        context: SecureContext[PeerT],
        protocol: WireProtocol,
    ) -> None:
        self._handler = handler
        self._context = context
        self._protocol = protocol
        self._streams: set[SecureStream[PeerT]] = set()
        self._slots: dict[SecureStream[PeerT], HalfOpenSlot] = {}  # of the unauthenticated ones
        self._tasks = TaskSet()
        self._loop = asyncio.get_running_loop()
        self._refused = 0
        self._report_again = 0.0

    @property
    def connections(self) -> int:
        """How many connections are open or half open."""
        return len(self._streams)

    def _admit(self, address: str) -> HalfOpenSlot | None:
        """A slot for one more unfinished handshake, if the limits allow it."""
        slot = self._context.half_open.admit(address)
        if slot is not None:
            return slot
        self._refused += 1
        if self._loop.time() >= self._report_again:  # at most one line in `_REPORT_EVERY` seconds
            _log.warning(
                "too many unfinished handshakes: refused %d, last %s", self._refused, address
            )
            self._refused, self._report_again = 0, self._loop.time() + _REPORT_EVERY
        return None

    def _begin(
        self,
        transport: Callable[[TransportOwner], ByteTransport],
        address: str,
        slot: HalfOpenSlot,
    ) -> SecureStream[PeerT]:
        """Begin the handshake; when that fails, the transport is still the caller's."""
        try:
            core = self._context.responder(self._protocol)
            stream = SecureStream(core, transport, address, self._on_authenticated, self._on_end)
        except BaseException:
            slot.release()
            raise
        self._streams.add(stream)
        self._slots[stream] = slot
        slot.close = partial(stream.abort, "evicted: too many unfinished handshakes")
        stream.when_closed(partial(self._release_slot, stream))
        return stream

    def _release_slot(self, stream: SecureStream[PeerT]) -> None:
        """The peer is authenticated, or the socket is closed."""
        slot = self._slots.pop(stream, None)
        if slot is not None:
            slot.release()

    def _on_authenticated(self, stream: SecureStream[PeerT]) -> None:
        """Start the handler."""
        self._release_slot(stream)
        self._tasks.spawn(self._handle(stream), name=f"rossec connection from {stream.address}")

    def _on_end(self, stream: SecureStream[PeerT], error: ChannelError) -> None:
        """Forget the connection; log a failed handshake."""
        if stream not in self._streams:
            return
        self._streams.discard(stream)
        if not stream.authenticated:
            if stream in self._slots:
                self._slots[stream].linger()  # until it is closed
            level = logging.WARNING if isinstance(error, PlainPeer) else logging.INFO
            _log.log(level, "connection from %s refused: %s", stream.address, error)

    async def _handle(self, stream: SecureStream[PeerT]) -> None:
        try:
            try:
                await self._handler(stream)
            except ChannelError as error:
                _log.info("connection from %s ended: %s", stream.address, error)
            await stream.close()
        except BaseException:  # also while the peer is waited for: its socket would stay
            stream.abort("the handler did not finish")
            raise  # a crash is logged by the task's owner

    async def close(self) -> None:
        """Abort every connection, wait until the handlers are gone."""
        await self._tasks.close()
        for stream in [*self._streams, *self._slots]:
            stream.abort("the server was closed")

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.close()
