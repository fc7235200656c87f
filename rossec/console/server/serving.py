"""uvicorn in this process's loop, with limits that it lacks: for what comes before a whole head.

No access log: a path can name a robot. No server header, no headers of a proxy read, no websockets.
A connection has a deadline for every request's head, so nobody holds one by sending a byte a
minute, and a place from `accept` until it is closed (`places`); what cannot be read is not
answered.
"""

import asyncio
import logging
import socket
import ssl
from collections.abc import Iterable
from contextlib import suppress
from email.utils import formatdate
from functools import partial
from typing import Any, Final

from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.config import Config
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle
from uvicorn.server import ServerState

from rossec.console.server.peer import check_peer
from rossec.console.server.places import ConnectionShares, Place
from rossec.errors import PeerUserRefused
from rossec.net.aio.server import ACCEPT_PAUSE
from rossec.net.aio.tasks import TaskSet
from rossec.net.host.peeruid import require_user

HEAD_TIME: Final = 15.0  # seconds for a request's head, from the connection or the answer before
MAX_HEAD: Final = 16 * 1024
KEEP_ALIVE: Final = 10  # seconds between two requests
PLACE: Final = "rossec.place"  # in a request's scope: the place of its connection
_ACCEPTS_PER_TURN: Final = 16

_log = logging.getLogger("rossec.console")


class BoundedProtocol(H11Protocol):
    """A connection that must send a whole head in time."""

    _deadline: asyncio.TimerHandle | None = None
    place: Place | None = None
    has_begun = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin with a connection, whose handshake is done if it has one."""
        super().connection_made(transport)
        self.has_begun = True
        if self.place is not None:
            self.place.closed_by(transport.abort)
            self.app = _Placed(self.app, self.place)
        self._arm()

    def data_received(self, data: bytes) -> None:
        """Take bytes; a deadline runs while no whole head is there."""
        date = formatdate(usegmt=True).encode()  # RFC 9110 section 6.6.1
        self.server_state.default_headers = [(b"date", date)]
        super().data_received(data)
        if self._is_answering:
            self._disarm()

    def on_response_complete(self) -> None:
        """Wait for the next head."""
        self._arm()
        super().on_response_complete()
        if self._is_answering:  # it was there already
            self._disarm()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the deadline, and give the place back."""
        self._disarm()
        if self.place is not None:
            self.place.release()
        super().connection_lost(exc)

    def send_400_response(self, msg: str) -> None:
        """Close instead: such an answer would lack the headers that all have."""
        del msg
        self.transport.abort()

    @property
    def _is_answering(self) -> bool:
        cycle: RequestResponseCycle | None = self.cycle  # None before the first request
        return cycle is not None and not cycle.response_complete

    def _arm(self) -> None:
        self._disarm()
        self._deadline = self.loop.call_later(HEAD_TIME, self.transport.abort)

    def _disarm(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


class _Placed:
    """The application, told of each request which place its connection has."""

    def __init__(self, app: Any, place: Place) -> None:
        self._app, self._place = app, place

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        await self._app({**scope, PLACE: self._place}, receive, send)


class ConsoleServer:
    """Serves one application at sockets that listen already.

    Args:
        app: the application.
        context: for TLS; None: plain HTTP.
        proxy_users: user ids whose programs may connect at a unix socket.
        users: user ids whose programs may connect on localhost; None: it is not there.
    """

    def __init__(
        self,
        app: ASGIApp,
        context: ssl.SSLContext | None = None,
        proxy_users: frozenset[int] = frozenset(),
        users: frozenset[int] | None = None,
    ) -> None:
        self._config = Config(
            app, http=BoundedProtocol, ws="none", lifespan="off", interface="asgi3",
            log_config=None, access_log=False, proxy_headers=False, server_header=False,
            timeout_keep_alive=KEEP_ALIVE, h11_max_incomplete_event_size=MAX_HEAD,
        )  # fmt: skip
        self._config.load()
        self._state = ServerState()
        self._context = context
        self._proxy_users, self._users = proxy_users, users
        self._listening: list[socket.socket] = []
        self._beginning = TaskSet()
        self.places = ConnectionShares()

    async def start(self, sockets: Iterable[socket.socket]) -> None:
        """Serve at each of the sockets."""
        for sock in sockets:
            sock.setblocking(False)
            self._listening.append(sock)
            self._add_reader(sock)

    def _add_reader(self, listening: socket.socket) -> None:
        if listening in self._listening:  # it was not closed meanwhile
            asyncio.get_running_loop().add_reader(listening.fileno(), self._accept, listening)

    def _accept(self, listening: socket.socket) -> None:
        """Accept a few, then return to the loop for the open connections."""
        loop = asyncio.get_running_loop()
        for _ in range(_ACCEPTS_PER_TURN):
            try:
                sock, where = listening.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:  # out of descriptors or memory: callers wait in the kernel
                _log.warning("cannot accept connections for %s s: %s", ACCEPT_PAUSE, error)
                loop.remove_reader(listening.fileno())
                loop.call_later(ACCEPT_PAUSE, self._add_reader, listening)
                return
            place = self._place_for(sock, where)
            if place is None:
                sock.close()
                continue
            sock.setblocking(False)
            place.closed_by(partial(_end, sock))
            self._beginning.spawn(self._begin(sock, place), name="a connection of the console")

    def _place_for(self, sock: socket.socket, where: Any) -> Place | None:
        """A place for a connection; None: it is of no user who may connect, or there is no room."""
        if sock.family == socket.AF_UNIX:  # a proxy
            try:
                require_user(sock, self._proxy_users)
            except (PeerUserRefused, OSError) as error:
                _log.warning("refused at the console's socket: %s", error)
                return None
            return self.places.take("", is_other_user=False)
        scope = {"client": where[:2], "server": sock.getsockname()[:2]}
        try:
            check_peer(scope, self._users)
        except PeerUserRefused:  # a few of them are told so, by the guard
            return self.places.take(where[0], is_other_user=True)
        return self.places.take(where[0], is_other_user=False)

    async def _begin(self, sock: socket.socket, place: Place) -> None:
        """The handshake, if there is one; then the connection is its protocol's."""
        loop = asyncio.get_running_loop()
        protocol = BoundedProtocol(self._config, self._state, {}, loop)
        protocol.place = place
        handshake = None if self._context is None else HEAD_TIME
        try:
            await loop.connect_accepted_socket(
                lambda: protocol, sock, ssl=self._context, ssl_handshake_timeout=handshake
            )
        except OSError as error:  # also of TLS
            _log.info("a connection ended before it began: %s", error)
        finally:
            if not protocol.has_begun:  # what began with the socket has closed it
                place.release()

    async def close(self) -> None:
        """Stop, and end every connection."""
        while self._listening:
            sock = self._listening.pop()
            asyncio.get_running_loop().remove_reader(sock.fileno())
            sock.close()
        for _ in range(2):  # until what was accepted last has a transport, which closes its socket
            await asyncio.sleep(0)
        await self._beginning.close()
        for connection in list(self._state.connections):
            connection.transport.abort()
        for task in list(self._state.tasks):
            task.cancel()
        await asyncio.gather(*self._state.tasks, return_exceptions=True)


def _end(sock: socket.socket) -> None:
    """End a connection whose transport has it: it sees the end, and closes."""
    with suppress(OSError):
        sock.shutdown(socket.SHUT_RDWR)
