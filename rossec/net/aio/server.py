"""Listening for secure connections: half open at first, then each with a task of its own.

Unauthenticated peers cost a bounded amount: the unfinished handshakes from one address and in total are
limited, each has one deadline. A handler ends with its connection: a crash is logged and closes that
connection only.
"""

import asyncio
import logging
import socket
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial
from typing import Final, Generic, Self, TypeAlias

from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.opening import WireProtocol
from rossec.errors import ChannelError, PlainPeer
from rossec.host.runner import TaskSet
from rossec.net.aio.stream import SecureStream
from rossec.net.aio.transport import ByteTransport, Transport, TransportOwner
from rossec.net.context import SecureContext
from rossec.net.limits import HalfOpenSlot

_log = logging.getLogger("rossec.net.server")
_REPORT_EVERY: Final = 10.0
_BACKLOG: Final = 128
# In one turn of the loop: what is connected already has its turn between.
_ACCEPTS_PER_TURN: Final = 16
ACCEPT_PAUSE: Final = 1.0  # seconds, when the host is out of descriptors

Handler: TypeAlias = Callable[[SecureStream[PeerT]], Awaitable[None]]


class AcceptedStreams(Generic[PeerT]):
    """Connections and their handlers: the base of what listens, on a port or at a rendezvous."""

    def __init__(
        self, handler: Handler[PeerT], context: SecureContext[PeerT], protocol: WireProtocol
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
        return len(self._streams)

    def _admit(self, address: str) -> HalfOpenSlot | None:
        slot = self._context.half_open.admit(address)
        if slot is not None:
            return slot
        self._refused += 1
        if self._loop.time() >= self._report_again:  # at most one line in `_REPORT_EVERY` seconds
            _log.warning("too many unfinished handshakes: refused %d, last %s", self._refused, address)
            self._refused, self._report_again = 0, self._loop.time() + _REPORT_EVERY
        return None

    def _begin(
        self, transport: Callable[[TransportOwner], ByteTransport], address: str, slot: HalfOpenSlot
    ) -> SecureStream[PeerT]:
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
        slot = self._slots.pop(stream, None)
        if slot is not None:
            slot.release()

    def _on_authenticated(self, stream: SecureStream[PeerT]) -> None:
        self._release_slot(stream)
        self._tasks.spawn(self._handle(stream), name=f"rossec connection from {stream.address}")

    def _on_end(self, stream: SecureStream[PeerT], error: ChannelError) -> None:
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
        await self._tasks.close()
        for stream in [*self._streams, *self._slots]:
            stream.abort("the server was closed")

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()


class SecureServer(AcceptedStreams[PeerT]):
    """A listening port and its connections; made by `serve`."""

    def __init__(
        self, handler: Handler[PeerT], context: SecureContext[PeerT], protocol: WireProtocol
    ) -> None:
        super().__init__(handler, context, protocol)
        self._listeners: list[socket.socket] = []
        self._suspended = False
        self.addresses: list[tuple[str, int]] = []

    @property
    def port(self) -> int:
        return self.addresses[0][1]

    def listen(self, host: str | None, port: int) -> None:
        for sock in bind(host, port):
            sock.setblocking(False)
            self.addresses.append(sock.getsockname()[:2])
            self._listeners.append(sock)
            self._add_reader(sock)

    def _add_reader(self, listener: socket.socket) -> None:
        if listener.fileno() >= 0 and not self._suspended:  # not closed meanwhile
            self._loop.add_reader(listener.fileno(), self._accept, listener)

    def _accept(self, listener: socket.socket) -> None:
        for _ in range(_ACCEPTS_PER_TURN):
            try:
                sock, where = listener.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:  # out of descriptors or memory: callers wait in the kernel
                _log.warning("cannot accept connections for %s s: %s", ACCEPT_PAUSE, error)
                self._loop.remove_reader(listener.fileno())
                self._loop.call_later(ACCEPT_PAUSE, self._add_reader, listener)
                return
            slot = self._admit(where[0])
            if slot is None:
                sock.close()
            else:
                address = where[0]
                try:
                    self._begin(partial(Transport, sock), address, slot)
                except BaseException:
                    sock.close()
                    raise

    def suspend(self) -> None:
        """Refuse connections as if the port were closed, but keep it bound. Linux keeps only a port that was
        given to bind(), not one it chose itself."""
        if self._suspended:  # shut down twice, what it accepts later would be at its end
            return
        self._suspended = True
        for listener in self._listeners:
            self._loop.remove_reader(listener.fileno())
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)  # no other socket may bind it
            listener.shutdown(socket.SHUT_RDWR)

    def resume(self) -> None:
        if not self._suspended:
            return
        self._suspended = False
        for listener in self._listeners:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.listen(_BACKLOG)
            self._add_reader(listener)

    async def close(self) -> None:
        for listener in self._listeners:
            self._loop.remove_reader(listener.fileno())
            listener.close()
        self._listeners.clear()
        await super().close()


def serve(
    handler: Handler[PeerT],
    host: str | None,
    port: int,
    context: SecureContext[PeerT],
    protocol: WireProtocol = WireProtocol.TCPROS,
) -> SecureServer[PeerT]:
    """Listen on `host` (None or "": every address, IPv4 and IPv6) and `port` (0: any free one).

    `handler` runs once per authenticated connection, which is closed when it returns. A connection that opens
    in another protocol gets the refusal meant for plain peers. Raises OSError: not an address of this host,
    or the port is taken.
    """
    server = SecureServer(handler, context, protocol)
    server.listen(host, port)
    return server


def bind(host: str | None, port: int) -> list[socket.socket]:
    if not host or host in {"0.0.0.0", "::"}:  # noqa: S104 - ROS nodes listen everywhere
        with suppress(OSError):  # a host without IPv6 is left with IPv4
            return [_bind_one(socket.AF_INET6, "::", port, dual=True)]
        return [_bind_one(socket.AF_INET, "", port)]
    # As text it would be encoded by Python's IDNA tables, 0.4 MB of memory, whatever it is.
    asked = host.encode("ascii") if host.isascii() else host
    found = socket.getaddrinfo(asked, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    addresses = dict.fromkeys((family, str(where[0])) for family, _, _, _, where in found)
    sockets: list[socket.socket] = []
    try:
        for family, address in addresses:
            chosen = sockets[0].getsockname()[1] if sockets else port
            sockets.append(_bind_one(family, address, chosen))
    except OSError:
        for sock in sockets:
            sock.close()
        raise
    return sockets


def _bind_one(family: int, address: str, port: int, *, dual: bool = False) -> socket.socket:
    return socket.create_server((address, port), family=family, backlog=_BACKLOG, dualstack_ipv6=dual)
