"""Secure connections for programs with threads: the socket methods that rospy uses.

`SecureSocket` is a byte stream. It never waits with the core locked, one thread writes at a time,
and its `fileno` is readable whenever `recv` has something: also when the bytes have left the kernel
already. Linux only: that descriptor is an epoll over the socket and an eventfd.
"""

import os
import secrets
import select
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from threading import Lock
from typing import Any, Final, Generic

from rossec.channel.connection import Connection
from rossec.channel.credentials import OwnCredential, PeerT, Verify
from rossec.channel.records import Bytes
from rossec.channel.states import DEAD, Authenticated, UnitReceived
from rossec.errors import ChannelClosed, ChannelError
from rossec.net.options import SocketOptions

_LONGEST_WAIT: Final = 3600.0  # then look at the clock again: the host's may be set
_SLICE: Final = struct.pack("ll", 5, 0)  # a struct timeval: how long the kernel waits in one go
_AT_ONCE: Final = socket.MSG_DONTWAIT


class SecureSocket(SocketOptions, Generic[PeerT]):
    """A connection over a connected TCP socket, which it owns.

    The handshake happens in the first `recv` or `send`, or in `do_handshake`. Two threads may use
    it, one to receive and one to send.

    Raises (every method that moves bytes):
        TimeoutError, BlockingIOError: as sockets do. A `send` that could not finish ends the
            connection: half a record cannot be taken back.
        ChannelError: the connection cannot be made, or has ended; `recv` returns b"" after a close.
    """

    def __init__(
        self,
        sock: socket.socket,
        core: Connection[PeerT],
        on_settled: Callable[[], None] = lambda: None,
    ) -> None:
        self.peer: PeerT | None = None
        self._timeout = sock.gettimeout()
        sock.settimeout(None)
        for option in (socket.SO_RCVTIMEO, socket.SO_SNDTIMEO):
            sock.setsockopt(socket.SOL_SOCKET, option, _SLICE)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = sock
        self._core = core
        self._on_settled: Callable[[], None] | None = on_settled
        self._units: deque[memoryview] = deque()
        self._error: ChannelError | None = None
        self._core_lock = Lock()
        self._reading = Lock()
        self._writing = Lock()
        self._closed = False
        self._event = -1
        self._flagged = False
        self._epoll: select.epoll | None = None

    @classmethod
    def connect(
        cls,
        address: tuple[str, int],
        credentials: OwnCredential,
        verify: Verify[PeerT],
        timeout: float | None = None,
        **options: Any,
    ) -> "SecureSocket[PeerT]":
        """Connect and authenticate; `options` are those of `Connection.initiator`.

        Raises:
            OSError: no TCP connection.
            ChannelError: the handshake failed.
        """
        sock = socket.create_connection(address, timeout)
        core = Connection[PeerT].initiator(
            credentials, verify, random=secrets.token_bytes, now=int(time.time()), **options
        )
        secure = SecureSocket(sock, core)
        try:
            secure.do_handshake()
        except BaseException:
            secure.close()
            raise
        return secure

    # -- what a socket tells and is told

    def fileno(self) -> int:
        """A descriptor to wait on for reading; -1 when closed. Made when first asked for."""
        with self._core_lock:
            if self._closed:
                return -1
            if self._epoll is None:
                self._event = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
                self._epoll = select.epoll()
                for fd in (self._socket.fileno(), self._event):
                    self._epoll.register(fd, select.EPOLLIN)
                self._flag()
            return self._epoll.fileno()

    # -- bytes

    def do_handshake(self) -> PeerT:
        """Return the peer, once it is authenticated."""
        end = self._end()
        while self.peer is None:
            self._raise_if_over()
            self._receive(end)
        return self.peer

    def recv(self, size: int) -> bytes:
        """Return 1 to `size` bytes; b"" after the peer's close."""
        with self._reading:
            chunk = self._take(size)
            return bytes(chunk)

    def recv_into(self, buffer: bytearray | memoryview, size: int = 0) -> int:
        """Receive into `buffer`; return how many bytes, 0 after the peer's close."""
        with self._reading, memoryview(buffer).cast("B") as view:
            chunk = self._take(size or len(view))
            view[: len(chunk)] = chunk
            return len(chunk)

    def receive_unit(self) -> bytes | memoryview:
        """The rest of a unit that `recv` began, or the next one; empty after the peer's close."""
        with self._reading:
            rest = self._take(self._core.unit_limit)
        unit = rest.obj
        return unit if isinstance(unit, bytes) and len(unit) == len(rest) else rest

    @property
    def awaits_peer(self) -> bool:
        """Whether the peer has yet to follow a renewal of the keys: `pump` soon."""
        return self._core.awaits_peer

    def pump(self) -> None:
        """Take in what has arrived, without waiting: for a side that only sends.

        Its peer's renewals and its close are met; units are dropped, for nobody asks for them.
        """
        end = self._end()
        with self._reading:
            while self._error is None and self._take_in(end, _AT_ONCE):
                self._units.clear()

    def _take(self, size: int) -> memoryview:
        end = self._end()
        while not self._units:
            if isinstance(self._error, ChannelClosed):
                return memoryview(b"")
            self._raise_if_over()
            self._receive(end)
        unit = self._units[0]
        if len(unit) <= size:
            self._units.popleft()
        else:
            self._units[0] = unit[size:]
        self._flag()
        return unit[:size]

    def send(self, data: Bytes) -> int:
        """Send everything; return how much that is."""
        self.sendall(data)
        return len(data)

    def sendall(self, *pieces: Bytes) -> None:
        """Send the pieces as one unit."""
        end = self._end()
        if self.peer is None:
            with self._reading:
                self.do_handshake()
        self._tick()
        with self._writing:
            self._raise_if_over()
            if not self._push_small(pieces, end):
                self._push_unit(pieces, end)
        self._flush(end)

    def _push_small(self, pieces: tuple[Bytes, ...], end: float | None) -> bool:
        """The short way of a small unit: one record, where nothing else has to be done."""
        if len(pieces) != 1 or not isinstance(pieces[0], bytes):
            return False
        with self._core_lock:
            record = self._core.seal_small(pieces[0])
        if record is not None:
            self._push(record, end)
        return record is not None

    def _push_unit(self, pieces: tuple[Bytes, ...], end: float | None) -> None:
        with self._core_lock:
            records = self._core.seal_unit(*pieces, reuse=True)
        while True:
            with self._core_lock:
                record = self._guarded(lambda: next(records, None))
            if record is None:
                return
            self._push(record, end)

    # -- the core and the socket

    def _receive(self, end: float | None) -> None:
        """Move bytes from the socket to the core, once; the caller is the one reader."""
        self._flush(end)
        self._tick()
        # One system call where there is no deadline to meet: the kernel waits, a slice at a time.
        flags = 0 if end is None and self.peer is not None else _AT_ONCE
        if not self._take_in(end, flags) and flags:
            self._wait(select.POLLIN, end)

    def _take_in(self, end: float | None, flags: int) -> bool:
        """Whether something had arrived."""
        try:
            count = self._socket.recv_into(self._core.get_buffer(), 0, flags)
        except BlockingIOError:
            return False
        except OSError:
            count = 0
        with self._core_lock:
            if count == 0:
                self._guarded(self._core.receive_eof)
                self._fail(ChannelClosed("the peer closed the connection"))
            else:
                self._note(self._guarded(lambda: self._core.buffer_updated(count, _now())))
        if self._error is None:
            self._flush(end)
        else:
            self._send_last(self._core.data_to_send())  # the peer may be gone
        return True

    def _note(self, events: Sequence[object]) -> None:
        for event in events:
            if isinstance(event, UnitReceived):
                self._units.append(memoryview(event.data))
            elif isinstance(event, Authenticated):
                self.peer = event.identity
                self._settle()
            else:
                self._fail(ChannelClosed("the peer closed the connection"))

    def _guarded(self, step: Callable[[], Any]) -> Any:
        try:
            return step()
        except ChannelError as error:
            self._fail(error)
            self._send_last(self._core.data_to_send())
            raise

    def _send_last(self, flight: Bytes) -> None:
        with suppress(OSError):
            self._socket.send(flight, _AT_ONCE)

    def _fail(self, error: ChannelError) -> None:
        self._error = self._error or error
        self._settle()

    def _settle(self) -> None:
        settled, self._on_settled = self._on_settled, None
        if settled is not None:
            settled()

    def _raise_if_over(self) -> None:
        if self._error is not None:
            raise self._error

    def _tick(self) -> None:
        with self._core_lock:
            self._guarded(lambda: self._core.tick(_now()))

    def _flush(self, end: float | None) -> None:
        """Write what the core queued; whoever is writing looks again when it is done."""
        while self._core.has_data_to_send:
            if not self._writing.acquire(blocking=False):
                return
            try:
                with self._core_lock:
                    data = self._core.data_to_send()
                self._push(data, end)
            finally:
                self._writing.release()

    def _push(self, data: Bytes, end: float | None) -> None:
        rest = memoryview(data)
        flags = 0 if end is None else _AT_ONCE
        try:
            while rest:
                try:
                    rest = rest[self._socket.send(rest, flags) :]
                except BlockingIOError:
                    self._wait(select.POLLOUT, end)
        except BaseException as error:
            self._fail(ChannelClosed("a message was given up half-way"))
            if isinstance(error, OSError) and not isinstance(error, TimeoutError | BlockingIOError):
                raise ChannelClosed("the connection is closed") from error
            raise

    # -- waiting

    def _end(self) -> float | None:
        return None if self._timeout is None else time.monotonic() + self._timeout

    def _wait(self, event: int, end: float | None) -> None:
        """Wait for the socket, for the caller's deadline, or for the core's."""
        left = _LONGEST_WAIT if end is None else end - time.monotonic()
        if left <= 0:
            raise BlockingIOError if self._timeout == 0 else TimeoutError("timed out")
        deadline = self._core.deadline()
        if deadline is not None:
            left = min(left, max(0.0, deadline - time.time()) + 0.001)
        poll = select.poll()
        poll.register(self._socket.fileno(), event)
        poll.poll(left * 1000)
        self._tick()

    def _flag(self) -> None:
        """Keep the eventfd readable exactly while decrypted bytes wait here."""
        wanted = len(self._units) > 0
        if wanted != self._flagged and self._epoll is not None:
            self._flagged = wanted
            if wanted:
                os.eventfd_write(self._event, 1)
            else:
                os.eventfd_read(self._event)

    # -- ends

    def detach(self) -> socket.socket:
        """Give the TCP socket back, before anything was read from it."""
        self._closed = True
        self._fail(ChannelClosed("the connection was given back"))
        return self._socket

    def shutdown(self, how: int = socket.SHUT_RDWR) -> None:
        """Close in order (`SHUT_RD` alone does nothing: the peer cannot be told)."""
        if how == socket.SHUT_RD:
            return
        with self._core_lock:
            if self._core.state not in DEAD:
                self._core.close()
        if self._writing.acquire(timeout=0.1):  # a writer that is stuck is cut off
            try:
                self._send_last(self._core.data_to_send())
            finally:
                self._writing.release()
        self._fail(ChannelClosed("the connection was closed"))
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)  # wakes whoever waits

    def close(self) -> None:
        """Close in order, and give the descriptors back."""
        with self._core_lock:
            closed, self._closed = self._closed, True
        if closed:
            return
        self.shutdown()
        if self._epoll is not None:
            self._epoll.close()
            os.close(self._event)
        self._socket.close()

    def __enter__(self) -> "SecureSocket[PeerT]":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _now() -> int:
    return int(time.time())
