"""Listening on a port for secure connections; what becomes of them is in `accepted`."""

import logging
import socket
from contextlib import suppress
from functools import partial
from typing import Final

from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.opening import WireProtocol
from rossec.net.aio.accepted import AcceptedStreams, Handler
from rossec.net.aio.transport import Transport
from rossec.net.context import SecureContext
from rossec.net.halfopen import HalfOpenSlot

_log = logging.getLogger("rossec.net.server")
_BACKLOG: Final = 128
_ACCEPTS_PER_TURN: Final = 16
ACCEPT_PAUSE: Final = 1.0  # seconds, when the host is out of descriptors


class SecureServer(AcceptedStreams[PeerT]):
    """A listening port and its connections; made by `serve`."""

    def __init__(
        self,
        handler: Handler[PeerT],
        context: SecureContext[PeerT],
        protocol: WireProtocol,
    ) -> None:
        super().__init__(handler, context, protocol)
        self._listeners: list[socket.socket] = []
        self._suspended = False
        self.addresses: list[tuple[str, int]] = []

    @property
    def port(self) -> int:
        """The port, the same on every address."""
        return self.addresses[0][1]

    def listen(self, host: str | None, port: int) -> None:
        """Bind and start to accept."""
        for sock in bind(host, port):
            sock.setblocking(False)
            self.addresses.append(sock.getsockname()[:2])
            self._listeners.append(sock)
            self._add_reader(sock)

    def _add_reader(self, listener: socket.socket) -> None:
        if listener.fileno() >= 0 and not self._suspended:  # not closed meanwhile
            self._loop.add_reader(listener.fileno(), self._accept, listener)

    def _accept(self, listener: socket.socket) -> None:
        """Accept a few, then return to the loop for the open connections."""
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
                self._begin_on(sock, where[0], slot)

    def _begin_on(self, sock: socket.socket, address: str, slot: HalfOpenSlot) -> None:
        try:
            self._begin(partial(Transport, sock), address, slot)
        except BaseException:
            sock.close()
            raise

    def suspend(self) -> None:
        """Refuse connections as if the port were closed, but keep it bound.

        Linux keeps only a port that was given to bind(), not one it chose itself.
        """
        if self._suspended:  # shut down twice, what it accepts later would be at its end
            return
        self._suspended = True
        for listener in self._listeners:
            self._loop.remove_reader(listener.fileno())
            listener.setsockopt(
                socket.SOL_SOCKET, socket.SO_REUSEADDR, 0
            )  # no other socket may bind it
            listener.shutdown(socket.SHUT_RDWR)

    def resume(self) -> None:
        """Listen again after `suspend`."""
        if not self._suspended:
            return
        self._suspended = False
        for listener in self._listeners:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.listen(_BACKLOG)
            self._add_reader(listener)

    async def close(self) -> None:
        """Stop listening, abort every connection, wait until the handlers are gone."""
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

    `handler` runs once per authenticated connection, which is closed when it returns. A connection
    that opens in another protocol gets the refusal meant for plain peers.

    Raises:
        OSError: not an address of this host, or the port is taken.
    """
    server = SecureServer(handler, context, protocol)
    server.listen(host, port)
    return server


def bind(host: str | None, port: int) -> list[socket.socket]:
    """Bind every address `host` stands for, all with one port."""
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
    return socket.create_server(
        (address, port), family=family, backlog=_BACKLOG, dualstack_ipv6=dual
    )
