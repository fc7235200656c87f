"""Secure connections for programs with threads: the socket methods that rospy uses.

`SecureSocket` is a byte stream over the core of a connection. The core is never locked while anything waits.
One thread reads and one writes at a time; what the core queues meanwhile is written by the writing thread.
"""

import select
import socket
import struct
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from threading import Lock
from typing import Any, Final, Generic, Self

from rossec import clock
from rossec.channel import negotiation
from rossec.channel.connection import Connection
from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.negotiation import ENDED, Authenticated, ConnectionState, UnitReceived
from rossec.channel.opening import WireProtocol
from rossec.channel.records import Bytes
from rossec.errors import ChannelClosed, ChannelError
from rossec.net.context import SecureContext, forget_in_children

_MAX_WAIT: Final = 3600.0  # then check the clock again: the host's may be set
SLICE: Final = struct.pack("ll", 5, 0)  # a struct timeval: how long the kernel waits in one go
AT_ONCE: Final = socket.MSG_DONTWAIT
PUMPED: Final = 16  # buffers in one go


def _now() -> int:  # tests set it, for connections alone
    return clock.now()


class SecureSocket(Generic[PeerT]):
    """A connection over a connected TCP socket, which it owns.

    The handshake happens in `do_handshake`, or in the first `recv` or `sendall`. Two threads may
    use it, one to receive and one to send.

    Raises (every method that moves bytes):
        TimeoutError, BlockingIOError: as sockets do. A `sendall` that could not finish ends the
            connection: half a record cannot be taken back.
        ChannelError: the connection cannot be made, or has ended; `recv` returns b"" after a close.
    """

    def __init__(
        self, sock: socket.socket, core: Connection[PeerT], on_released: Callable[[], None] = lambda: None
    ) -> None:
        self.peer: PeerT | None = None
        self._timeout = sock.gettimeout()
        sock.settimeout(None)
        for option in (socket.SO_RCVTIMEO, socket.SO_SNDTIMEO):
            sock.setsockopt(socket.SOL_SOCKET, option, SLICE)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = sock
        self._core = core
        self._on_released: Callable[[], None] | None = on_released
        self._units: deque[bytes | memoryview] = deque()
        self._renewed: deque[negotiation.Renewal[PeerT]] = deque()
        self._on_renewal: Callable[[negotiation.Renewal[PeerT]], None] | None = None
        self._error: ChannelError | None = None
        self._timers_run_at = -1
        self._aborted = self._closed = False
        self._core_lock = Lock()
        self._reading = Lock()
        self._writing = Lock()
        forget_in_children(self)
        if core.streams is not None:
            core.streams.add(self)

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
        """Authenticate within `timeout` seconds, over a connected socket; `to_itself`: it means itself."""
        secure = cls(sock, context.initiator(protocol, to_itself=to_itself))
        try:
            secure.settimeout(timeout)
            secure.do_handshake()
            secure.settimeout(None)
        except BaseException:
            secure.close()
            raise
        return secure

    def abandon(self) -> None:
        # A lock that another thread held at the fork would never be released.
        self._core_lock, self._reading, self._writing = Lock(), Lock(), Lock()
        self._core.abandon()
        self._units.clear()
        self._error = ChannelClosed("a forked process cannot use its parent's connections")
        self._on_released = None  # its lock may never be released
        self._socket.close()

    def disconnect(self) -> None:
        # The kernel would still return bytes that arrived before.
        self._aborted = True
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def abort(self, _reason: str = "") -> None:
        if not self._aborted:
            self.disconnect()

    # -- receiving

    def _receive(self, end: float | None) -> None:
        self._run_timers(reading=True)
        self._flush(end)
        # One system call where there is no deadline: the kernel waits, a slice at a time.
        flags = 0 if end is None and self.peer is not None else AT_ONCE
        if not self._take_in(end, flags) and flags:
            self._wait(select.POLLIN, end)

    def _take_in(self, end: float | None, flags: int) -> bool:
        try:
            count = self._socket.recv_into(self._core.get_buffer(), 0, flags)
        except BlockingIOError:
            return False
        except OSError:
            count = 0
        with self._core_lock:
            if count == 0 and self._aborted:
                self._fail(ChannelClosed("the connection was aborted"))
            elif count == 0:
                self._call_core(self._core.receive_eof)
                self._fail(ChannelClosed("the peer closed the connection"))
            elif (unit := self._call_core(self._core.lone_unit, count)) is not None:
                self._units.append(unit)
            else:
                self._handle_events(self._call_core(self._core.buffer_updated, count, _now()))
        if self._renewed:
            self._tell_renewals()
        if self._error is None:
            self._flush(end)
        else:
            self._send_last(self._core.data_to_send())  # the peer may be gone
        return True

    def _handle_events(self, events: Sequence[negotiation.Event[PeerT]]) -> None:
        for event in events:
            if isinstance(event, UnitReceived):
                self._units.append(event.data)
            elif isinstance(event, Authenticated):
                self.peer = event.identity
                self._release()
            elif isinstance(event, negotiation.Closed):
                self._fail(ChannelClosed("the peer closed the connection"))
            elif isinstance(event, negotiation.GrantsPresented):
                # The newest counts, also before anybody listens.
                others = (each for each in self._renewed if not isinstance(each, negotiation.GrantsPresented))
                self._renewed = deque((*others, event))
            else:
                if isinstance(event, negotiation.IdentityRenewed):
                    self.peer = event.identity
                if self._on_renewal is not None:
                    self._renewed.append(event)

    # -- what is renewed

    def _tell_renewals(self) -> None:
        while self._on_renewal is not None and self._renewed:
            self._on_renewal(self._renewed.popleft())

    def on_renewal(self, callback: Callable[[negotiation.Renewal[PeerT]], None]) -> None:
        self._on_renewal = callback
        self._tell_renewals()

    def present_identity(self, chain: Sequence[bytes]) -> None:
        with self._core_lock:
            self._core.present_identity(chain)
        self._send_queued()

    def present_grants(self, data: bytes) -> bool:
        with self._core_lock:
            taken = self._error is None and self._core.present_grants(data)
        self._send_queued()
        return taken

    def _send_queued(self) -> None:
        if self.peer is None or not self._writing.acquire(blocking=False):
            return  # who writes just now sends it after that
        try:
            with suppress(ChannelError), self._core_lock:  # where it has ended, its users get the error
                if self._core.has_data_to_send:
                    self._core.put_back(self._send_nowait(self._core.data_to_send()))
        finally:
            self._writing.release()

    def _call_core(self, step: Callable[..., Any], *arguments: object) -> Any:
        try:
            return step(*arguments)
        except ChannelError as error:
            self._fail(error)
            self._send_last(self._core.data_to_send())
            raise

    def _send_last(self, flight: Bytes) -> None:
        with suppress(OSError):
            self._socket.send(flight, AT_ONCE)

    def _fail(self, error: ChannelError) -> None:
        self._error = self._error or error.bare()

    def _release(self) -> None:
        released, self._on_released = self._on_released, None
        if released is not None:
            released()

    def _raise_if_ended(self) -> None:
        if self._error is not None:
            raise self._error.bare()

    # -- sending

    def _flush(self, end: float | None) -> None:
        while self._core.has_data_to_send:
            if not self._writing.acquire(blocking=False):
                return
            try:
                with self._core_lock:
                    data = self._core.data_to_send()
                self._write(data, end)
            finally:
                self._writing.release()

    def _write(self, data: Bytes, end: float | None) -> None:
        rest = memoryview(data)
        flags = 0 if end is None else AT_ONCE
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

    def _send_nowait(self, data: Bytes) -> Bytes:
        try:
            return memoryview(data)[self._socket.send(data, AT_ONCE) :]
        except BlockingIOError:
            return data
        except OSError as error:
            self._fail(ChannelClosed("the connection is closed"))
            raise ChannelClosed("the connection is closed") from error

    # -- waiting

    def settimeout(self, value: float | None) -> None:
        self._timeout = value

    def gettimeout(self) -> float | None:
        return self._timeout

    def _end(self) -> float | None:
        return None if self._timeout is None else time.monotonic() + self._timeout

    def _wait(self, event: int, end: float | None) -> None:
        left = _MAX_WAIT if end is None else end - time.monotonic()
        if left <= 0:
            raise BlockingIOError if self._timeout == 0 else TimeoutError("timed out")
        deadline = self._core.deadline()
        if deadline is not None:
            left = min(left, max(0.0, deadline - clock.time()) + 0.001)
        poll = select.poll()
        poll.register(self._socket.fileno(), event)
        poll.poll(left * 1000)
        self._run_timers(reading=event == select.POLLIN)

    def _run_timers(self, *, reading: bool = False) -> None:
        now = _now()
        if now == self._timers_run_at:
            return
        # A connection that is only written to, or cached, has no reader: the confirmation is taken in here,
        # unless another thread reads.
        if self._core.state is ConnectionState.WAIT_4 and (reading or self._reading.acquire(blocking=False)):
            try:
                self._take_in(None, AT_ONCE)
            finally:
                if not reading:
                    self._reading.release()
        with self._core_lock:
            self._call_core(self._core.tick, now)
        self._timers_run_at = now

    # -- for users

    def raise_unit_limit(self, limit: int | None = None) -> None:
        """Accept units of up to `limit`, or `ChannelLimits.unit`: the peer is authorized."""
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
            return bytes(self._take(size))

    def recv_into(self, buffer: bytearray | memoryview, size: int = 0) -> int:
        """Receive into `buffer`; return how many bytes, 0 after the peer's close."""
        with self._reading, memoryview(buffer).cast("B") as view:
            chunk = self._take(size or len(view))
            view[: len(chunk)] = chunk
            return len(chunk)

    def receive_unit(self) -> bytes | memoryview:
        with self._reading:
            return self._take(sys.maxsize)

    @property
    def awaits_peer(self) -> bool:
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
        """Handle key renewals of both sides while the connection is not used. Never waits: where a thread
        reads or writes just now, that thread handles them."""
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
        end = self._end()
        if self.peer is None:
            with self._reading:
                self.do_handshake()
        self._run_timers()
        with self._writing:
            self._raise_if_ended()
            record: Bytes | None = None
            if len(pieces) == 1 and isinstance(pieces[0], bytes):
                with self._core_lock:
                    record = self._core.seal_small(pieces[0])
            if record is not None:
                self._write(record, end)
            else:
                with self._core_lock:
                    records = self._core.seal_unit(*pieces, reuse=True)
                    record = self._call_core(next, records, None)
                while record is not None:  # the lock is never held while a record is written
                    self._write(record, end)
                    with self._core_lock:
                        record = self._call_core(next, records, None)
        self._flush(end)

    def try_send(self, data: bytes) -> bool:
        """Send a small unit where this needs no waiting; False: nothing was sent. What the kernel did not
        take is `unsent`, and is sent before anything else."""
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
