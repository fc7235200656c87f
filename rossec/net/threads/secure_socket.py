"""Secure connections for programs with threads: the socket methods that rospy uses.

`SecureSocket` is a byte stream. It never waits with the core locked, and one thread writes at a
time.
"""

import socket
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Final, Self

from rossec.channel.connection import Connection
from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.opening import WireProtocol
from rossec.channel.records import Bytes
from rossec.channel.states import ENDED
from rossec.errors import ChannelClosed
from rossec.net.context import SecureContext
from rossec.net.threads.carrier import AT_ONCE, Carrier

PUMPED: Final = 16  # buffers in one go


class SecureSocket(Carrier[PeerT]):
    """A connection over a connected TCP socket, which it owns.

    The handshake happens in `do_handshake`, or in the first `recv` or `sendall`. Two threads may
    use it, one to receive and one to send.

    Raises (every method that moves bytes):
        TimeoutError, BlockingIOError: as sockets do. A `sendall` that could not finish ends the
            connection: half a record cannot be taken back.
        ChannelError: the connection cannot be made, or has ended; `recv` returns b"" after a close.
    """

    def __init__(
        self,
        sock: socket.socket,
        core: Connection[PeerT],
        on_released: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(sock, core, on_released)
        self._closed = False

    @classmethod
    def initiate(
        cls,
        sock: socket.socket,
        context: SecureContext[PeerT],
        protocol: WireProtocol = WireProtocol.TCPROS,
        *,
        to_itself: bool = False,
        timeout: float | None = None,
    ) -> Self:
        """Authenticate, within `timeout` in seconds, over a socket that was connected.

        `to_itself`: this node means to reach itself.

        Raises:
            OSError, ChannelError: the handshake failed; the socket is closed.
        """
        secure = cls(sock, context.initiator(protocol, to_itself=to_itself))
        try:
            secure.settimeout(timeout)
            secure.do_handshake()
            secure.settimeout(None)
        except BaseException:
            secure.close()
            raise
        return secure

    def raise_unit_limit(self, limit: int | None = None) -> None:
        """Accept units of up to `limit`, or `ChannelLimits.unit`: the peer is authorized.

        Raises:
            ChannelClosed: there is no open connection.
        """
        with self._core_lock:
            self._core.raise_unit_limit(limit)

    def pad_units(self, multiple: int) -> None:
        """Pad what is sent from now on to a multiple of so many bytes; 0: do not."""
        with self._core_lock:
            self._core.pad_units(multiple)

    # -- bytes

    def do_handshake(self) -> PeerT:
        """Return the peer, once it is authenticated."""
        end = self._end()
        while self.peer is None:
            self._raise_if_ended()
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
            return self._take(sys.maxsize)

    @property
    def awaits_peer(self) -> bool:
        """Whether the peer has yet to follow a renewal of the keys: call `pump` soon."""
        return self._core.awaits_peer

    def pump(self) -> None:
        """Process received bytes, without waiting: for a side that only sends.

        Handles the peer's key renewals and its close; units are dropped. A peer that floods is read
        no faster than this is called: flow control holds back the rest.
        """
        end = self._end()
        with self._reading:
            for _ in range(PUMPED):
                if self._error is not None or not self._take_in(end, AT_ONCE):
                    return
                self._units.clear()

    def run_timers(self) -> None:
        """Handle key renewals of both sides while the connection is not used.

        Never waits: where a thread reads or writes just now, that thread handles them.
        """
        if self._units or self.peer is None or not self._writing.acquire(blocking=False):
            return
        try:
            if self._reading.acquire(blocking=False):
                try:
                    self._take_in(None, AT_ONCE)
                finally:
                    self._reading.release()
            self._run_timers()  # after the peer's answer to the last renewal
            with self._core_lock:
                if self._core.has_data_to_send:
                    self._core.put_back(self._send_nowait(self._core.data_to_send()))
        finally:
            self._writing.release()

    def _take(self, size: int) -> bytes | memoryview:
        end = self._end()
        while not self._units:
            if isinstance(self._error, ChannelClosed):
                return b""
            self._raise_if_ended()
            self._receive(end)
        if self._aborted:
            return b""
        unit = self._units.popleft()
        if len(unit) > size:
            whole = memoryview(unit)
            self._units.appendleft(whole[size:])
            unit = whole[:size]
        return unit

    def sendall(self, *pieces: Bytes) -> None:
        """Send the pieces as one unit."""
        end = self._end()
        if self.peer is None:
            with self._reading:
                self.do_handshake()
        self._run_timers()
        with self._writing:
            self._raise_if_ended()
            if not self._write_small(pieces, end):
                self._write_unit(pieces, end)
        self._flush(end)

    def try_send(self, data: bytes) -> bool:
        """Send a small unit where this needs no waiting; False: nothing was sent.

        What the kernel did not take is `unsent`, and is sent before anything else.
        """
        if self.peer is None or not self._writing.acquire(blocking=False):
            return False
        try:
            self._raise_if_ended()
            self._run_timers()
            with self._core_lock:
                record = self._core.seal_small(data)
                if record is not None:
                    self._core.put_back(self._send_nowait(record))
        finally:
            self._writing.release()
        return record is not None

    @property
    def unsent(self) -> bool:
        """Whether `try_send` left something: `sendall`, even of nothing, sends it."""
        return self._core.has_data_to_send

    # -- ends

    def detach(self) -> socket.socket:
        """Give the TCP socket back, before anything was read from it."""
        self._closed = True
        self._fail(ChannelClosed("the connection was given back"))
        self._release()
        return self._socket

    def shutdown(self, how: int = socket.SHUT_RDWR) -> None:
        """Close in order (`SHUT_RD` alone does nothing: the protocol has no message for it)."""
        if how == socket.SHUT_RD:
            return
        with self._core_lock:
            if self._core.state not in ENDED:
                self._core.close()
        if self._writing.acquire(timeout=0.1):  # a writer that is stuck is aborted
            try:
                self._send_last(self._core.data_to_send())
            finally:
                self._writing.release()
        self._fail(ChannelClosed("the connection was closed"))
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)  # wakes waiting threads

    def close(self) -> None:
        """Close in order, and give the descriptor back."""
        with self._core_lock:
            closed, self._closed = self._closed, True
        if closed:
            return
        self.shutdown()
        self._socket.close()
        self._release()

    def __enter__(self) -> "SecureSocket[PeerT]":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
