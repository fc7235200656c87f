"""The UDP socket of a border router, and the clock of its endpoint. A shell, with no logic.

The port is bound without SO_REUSEPORT: nobody else on this host may take a part of its datagrams.
What the network does not take is lost, as any datagram may be; things and router repeat. A lost
datagram costs its thing seconds, so the socket is emptied before anything of a stranger is looked
at, and strangers get a part of each turn (`intake`).
"""

import asyncio
import contextlib
import errno
import secrets
import socket
from collections.abc import Callable
from typing import Final

from rossec.border.endpoint import Endpoint, Events, Served
from rossec.border.handshakes import StaticKey
from rossec.border.intake import Intake
from rossec.border.requests import OnAnswer, Request
from rossec.border.transmissions import Address
from rossec.border.wire import MAX_DATAGRAM
from rossec.errors import ConfigurationError

PORT: Final = 5683
_READS: Final = 1024  # datagrams in one turn of the loop: 2 us each
_STRANGERS: Final = 8  # datagrams of strangers in one turn: up to 0.2 ms each
_BUFFER: Final = 4 << 20
_RCVBUFFORCE: Final = 33  # socket(7): beyond the limit of the system, for who may


class Server:
    """Serves things at one address.

    Args:
        own: the router's key for things.
        served: which things it serves.
        events: what is told of them.
        host: where it listens; `::` for everywhere, IPv4 as well.
        port: 0 for any.

    Raises:
        ConfigurationError: it cannot listen there.
    """

    def __init__(
        self, own: StaticKey, served: Served, events: Events, host: str = "::", port: int = PORT
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._socket = _bind(host, port)
        dice = secrets.SystemRandom().random
        self.endpoint: Final = Endpoint(own, served, events, self._send, secrets.token_bytes, dice)
        self._timer: asyncio.TimerHandle | None = None
        self._intake = Intake()
        self._turn: asyncio.Handle | None = None
        self._loop.add_reader(self._socket.fileno(), self._read)

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens: host and port."""
        host, port = self._socket.getsockname()[:2]
        return str(host), int(port)

    @property
    def lost(self) -> int:
        """How many datagrams were not looked at: too many of one port, host or thing, or in all."""
        return self._intake.lost

    def request(
        self, name: str, request: Request, on_answer: OnAnswer
    ) -> Callable[[], None] | None:
        """Ask the thing `name`; returns what cancels it. None: it is not there."""
        conversation = self.endpoint.conversations.of(name)
        if conversation is None:
            return None
        now = self._loop.time()
        exchange = self.endpoint.requests.start(conversation, request, on_answer, now)
        self._arm()
        return lambda: self.endpoint.requests.cancel(exchange)

    def drop(self, name: str) -> None:
        """End the conversation with a thing."""
        self.endpoint.conversations.drop(name)

    def close(self) -> None:
        """Stop."""
        self._loop.remove_reader(self._socket.fileno())
        self._socket.close()
        for handle in (self._timer, self._turn):
            if handle is not None:
                handle.cancel()

    def _read(self) -> None:
        at = self.endpoint.conversations.at
        for _ in range(_READS):
            try:
                data, address = self._socket.recvfrom(MAX_DATAGRAM + 1)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:  # an ICMP error for what was sent before
                continue
            now, known = self._loop.time(), at(address)
            if known is None:
                self._intake.put(data, address)
            elif self._intake.is_first(address, now):
                self.endpoint.receive(data, address, now)
            else:
                known.quota.dropped += 1
        if self._turn is None:
            self._take_strangers()
        self._arm()

    def _take_strangers(self) -> None:
        self._turn = None
        for _ in range(_STRANGERS):
            taken = self._intake.take()
            if taken is None:
                break
            self.endpoint.receive(*taken, self._loop.time())
        if self._intake:
            self._turn = self._loop.call_soon(self._take_strangers)
        self._arm()

    def _send(self, data: bytes, address: Address) -> None:
        with contextlib.suppress(OSError):
            self._socket.sendto(data, address)

    def _arm(self) -> None:
        """Wake when the next timer is due."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        due = self.endpoint.timers.next_due
        if due is not None:
            self._timer = self._loop.call_at(due, self._due)

    def _due(self) -> None:
        self._timer = None
        self.endpoint.run_timers(self._loop.time())
        self._arm()


def _bind(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    sock = socket.socket(family, socket.SOCK_DGRAM)
    try:
        if family == socket.AF_INET6:
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, host != "::")
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        with contextlib.suppress(PermissionError):
            sock.setsockopt(socket.SOL_SOCKET, _RCVBUFFORCE, _BUFFER)
        sock.setblocking(False)
        sock.bind((host, port))
    except OSError as error:
        sock.close()
        taken = error.errno == errno.EADDRINUSE
        raise ConfigurationError(
            f"cannot listen at {host} port {port} (UDP): {error.strerror}",
            "another border router runs there" if taken else "see --listen",
        ) from error
    return sock
