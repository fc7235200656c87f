"""Bytes between the core of a connection and its TCP socket, for programs with threads.

The core is never locked while anything waits. One thread reads and one writes at a time; what the
core queues meanwhile is written by the writing thread.
"""

import select
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from threading import Lock
from typing import Any, Final, Generic, cast

from rossec import clock
from rossec.channel.connection import Connection
from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.records import Bytes
from rossec.channel.states import (
    Authenticated,
    Closed,
    ConnectionState,
    GrantsPresented,
    IdentityRenewed,
    Renewal,
    UnitReceived,
)
from rossec.errors import ChannelClosed, ChannelError
from rossec.net.forks import forget_in_children

_MAX_WAIT: Final = 3600.0  # then check the clock again: the host's may be set
SLICE: Final = struct.pack("ll", 5, 0)  # a struct timeval: how long the kernel waits in one go
AT_ONCE: Final = socket.MSG_DONTWAIT


class Carrier(Generic[PeerT]):
    """What `SecureSocket` does below its methods; `end` is always the caller's deadline."""

    def __init__(
        self,
        sock: socket.socket,
        core: Connection[PeerT],
        on_released: Callable[[], None] = lambda: None,
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
        self._renewed: deque[Renewal[PeerT]] = deque()
        self._on_renewal: Callable[[Renewal[PeerT]], None] | None = None
        self._error: ChannelError | None = None
        self._timers_run_at = -1
        self._aborted = False
        self._core_lock = Lock()
        self._reading = Lock()
        self._writing = Lock()
        forget_in_children(self)
        if core.streams is not None:
            core.streams.add(self)

    def abandon(self) -> None:
        """As of `Inherited`: this descriptor is closed, the connection of the parent is not.

        A lock that another thread held at the fork would never be released.
        """
        self._core_lock, self._reading, self._writing = Lock(), Lock(), Lock()
        self._core.abandon()
        self._units.clear()
        self._error = ChannelClosed("a forked process cannot use its parent's connections")
        self._on_released = None  # its lock may never be released
        self._socket.close()

    def abort(self) -> None:
        """End it now, from any thread: waiting calls return, and nothing more is delivered.

        The kernel would still return bytes that arrived before.
        """
        self._aborted = True
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    # -- receiving

    def _receive(self, end: float | None) -> None:
        """Move bytes from the socket to the core, once; the caller is the one reader."""
        self._run_timers(reading=True)
        self._flush(end)
        # One system call where there is no deadline: the kernel waits, a slice at a time.
        flags = 0 if end is None and self.peer is not None else AT_ONCE
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
            if count == 0 and self._aborted:
                self._fail(ChannelClosed("the connection was aborted"))
            elif count == 0:
                self._call_core(self._core.receive_eof)
                self._fail(ChannelClosed("the peer closed the connection"))
            else:
                self._handle_events(self._call_core(self._core.buffer_updated, count, _now()))
        if self._renewed:
            self._tell_renewals()
        if self._error is None:
            self._flush(end)
        else:
            self._send_last(self._core.data_to_send())  # the peer may be gone
        return True

    def _handle_events(self, events: Sequence[object]) -> None:
        for event in events:
            if isinstance(event, UnitReceived):
                self._units.append(event.data)
            elif isinstance(event, Authenticated):
                self.peer = event.identity
                self._release()
            elif isinstance(event, Closed):
                self._fail(ChannelClosed("the peer closed the connection"))
            else:
                self._take_renewal(cast("Renewal[PeerT]", event))

    # -- what is renewed

    def _take_renewal(self, event: Renewal[PeerT]) -> None:
        if isinstance(event, IdentityRenewed):
            self.peer = event.identity
        if isinstance(event, GrantsPresented):  # the newest counts, also before anybody listens
            others = (each for each in self._renewed if not isinstance(each, GrantsPresented))
            self._renewed = deque((*others, event))
        elif self._on_renewal is not None:
            self._renewed.append(event)

    def _tell_renewals(self) -> None:
        """Tell the user, with no lock of the core held: judging takes its time, and locks."""
        while self._on_renewal is not None and self._renewed:
            self._on_renewal(self._renewed.popleft())

    def on_renewal(self, callback: Callable[[Renewal[PeerT]], None]) -> None:
        """Call back, in the thread that reads, with what the peer renews."""
        self._on_renewal = callback
        self._tell_renewals()

    @property
    def takes_renewals(self) -> bool:
        """As of `Connection`."""
        return self._core.takes_renewals

    def present_identity(self, chain: Sequence[bytes]) -> None:
        """As of `Connection`, from any thread; it is sent now, or with what is sent next."""
        with self._core_lock:
            self._core.present_identity(chain)
        self._send_queued()

    def present_grants(self, data: bytes) -> bool:
        """As of `Connection`, from any thread; as `present_identity`."""
        with self._core_lock:
            taken = self._error is None and self._core.present_grants(data)
        self._send_queued()
        return taken

    def _send_queued(self) -> None:
        """Send what the core has queued as far as that needs no waiting."""
        if self.peer is None or not self._writing.acquire(blocking=False):
            return  # who writes just now sends it after that
        try:
            with self._core_lock:
                if self._core.has_data_to_send:
                    self._core.put_back(self._send_nowait(self._core.data_to_send()))
        except ChannelError:
            pass  # the connection has ended: its users get the error
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
        """Call `on_released`: the peer is authenticated, or the socket was given back."""
        released, self._on_released = self._on_released, None
        if released is not None:
            released()

    def _raise_if_ended(self) -> None:
        if self._error is not None:
            raise self._error.bare()

    # -- sending

    def _write_small(self, pieces: tuple[Bytes, ...], end: float | None) -> bool:
        """The fast path of a small unit: one record."""
        if len(pieces) != 1 or not isinstance(pieces[0], bytes):
            return False
        with self._core_lock:
            record = self._core.seal_small(pieces[0])
        if record is not None:
            self._write(record, end)
        return record is not None

    def _write_unit(self, pieces: tuple[Bytes, ...], end: float | None) -> None:
        with self._core_lock:
            records = self._core.seal_unit(*pieces, reuse=True)
        while True:
            with self._core_lock:
                record = self._call_core(next, records, None)
            if record is None:
                return
            self._write(record, end)

    def _flush(self, end: float | None) -> None:
        """Write what the core queued; a thread that is writing checks again when it is done."""
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
        """Write what the kernel takes at once; returns the rest."""
        try:
            return memoryview(data)[self._socket.send(data, AT_ONCE) :]
        except BlockingIOError:
            return data
        except OSError as error:
            self._fail(ChannelClosed("the connection is closed"))
            raise ChannelClosed("the connection is closed") from error

    # -- waiting

    def settimeout(self, value: float | None) -> None:
        """As of sockets: None waits, 0 does not."""
        self._timeout = value

    def gettimeout(self) -> float | None:
        """What `settimeout` set."""
        return self._timeout

    def _end(self) -> float | None:
        return None if self._timeout is None else time.monotonic() + self._timeout

    def _wait(self, event: int, end: float | None) -> None:
        """Wait for the socket, for the caller's deadline, or for the core's."""
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
        """Run the core's timers, once in a second: its deadlines are whole seconds."""
        now = _now()
        if now == self._timers_run_at:
            return
        if self._core.state is ConnectionState.WAIT_4:
            self._take_in_confirmation(reading=reading)
        with self._core_lock:
            self._call_core(self._core.tick, now)
        self._timers_run_at = now

    def _take_in_confirmation(self, *, reading: bool) -> None:
        """Process received bytes before the timers: message_4 may have waited for a reader.

        A connection that is only written to, or cached, has no reader.
        """
        if not reading and not self._reading.acquire(blocking=False):
            return  # the reading thread takes it in
        try:
            self._take_in(None, AT_ONCE)
        finally:
            if not reading:
                self._reading.release()


def _now() -> int:
    return clock.now()
