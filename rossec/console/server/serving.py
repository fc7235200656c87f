"""uvicorn in this process's loop, with limits that it lacks: for headers that do not come.

No access log: a path can name a robot. No server header, no headers of a proxy read, no websockets.
A connection has a deadline for every request's head, so nobody holds one by sending a byte a
minute; their number is bounded, also for one address, and what cannot be read is not answered.
"""

import asyncio
import logging
import socket
import ssl
from collections.abc import Iterable
from email.utils import formatdate
from typing import Final

from starlette.types import ASGIApp
from uvicorn.config import Config
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle
from uvicorn.server import ServerState

from rossec.console.server.peer import check_peer
from rossec.errors import PeerUserRefused
from rossec.net.host.peeruid import require_user
from rossec.operation.unix_socket import raw_socket

HEAD_TIME: Final = 15.0  # seconds for a request's head, from the connection or the answer before
MAX_HEAD: Final = 16 * 1024
MAX_CONNECTIONS: Final = 256
MAX_FOR_ONE: Final = 128  # connections of one address; a browser has six, and a page one for news
MAX_STRANGERS: Final = 8  # connections of other users of this host; they are told, and no more
KEEP_ALIVE: Final = 10  # seconds between two requests

_log = logging.getLogger("rossec.console")


class BoundedProtocol(H11Protocol):
    """A connection that must send a whole head in time."""

    _deadline: asyncio.TimerHandle | None = None
    proxy_users: frozenset[int] = frozenset()  # who may connect at a unix socket
    users: frozenset[int] | None = None  # of localhost; None: anybody's programs may connect
    is_strange = False  # of another user, who gets no page and takes no place

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection, unless there are too many."""
        super().connection_made(transport)
        self.is_strange = self._is_of_a_stranger()
        if self._is_one_too_many() or not self._is_of_a_user(transport):
            transport.abort()
            return
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
        """Forget the deadline."""
        self._disarm()
        super().connection_lost(exc)

    def send_400_response(self, msg: str) -> None:
        """Close instead: such an answer would lack the headers that all have."""
        del msg
        self.transport.abort()

    def _is_one_too_many(self) -> bool:
        known = [each for each in self.connections if isinstance(each, BoundedProtocol)]
        open_now = [each for each in known if each.is_strange == self.is_strange]
        if len(open_now) > (MAX_STRANGERS if self.is_strange else MAX_CONNECTIONS):
            return True
        if not self.client:  # a unix socket, that is a proxy
            return False
        addresses = [each.client[0] for each in open_now if each.client]
        return addresses.count(self.client[0]) > MAX_FOR_ONE

    def _is_of_a_stranger(self) -> bool:
        """Whether another user of this host connected; for counting, as the guard decides."""
        try:
            check_peer({"client": self.client, "server": self.server}, self.users)
        except PeerUserRefused:
            return True
        return False

    def _is_of_a_user(self, transport: asyncio.Transport) -> bool:
        """Whether a proxy at a unix socket is of a user who may be one; TCP has its own check."""
        sock = transport.get_extra_info("socket")
        if sock is not None and sock.family != socket.AF_UNIX:
            return True
        try:
            require_user(raw_socket(sock), self.proxy_users)
        except (PeerUserRefused, OSError) as error:
            _log.warning("refused at the console's socket: %s", error)
            return False
        return True

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
        self._servers: list[asyncio.Server] = []

    async def start(self, sockets: Iterable[socket.socket]) -> None:
        """Serve at each of the sockets."""
        loop = asyncio.get_running_loop()
        for sock in sockets:
            handshake = None if self._context is None else HEAD_TIME
            server = await loop.create_server(
                lambda: self._make(loop), sock=sock,
                ssl=self._context, ssl_handshake_timeout=handshake,
            )  # fmt: skip
            self._servers.append(server)

    def _make(self, loop: asyncio.AbstractEventLoop) -> BoundedProtocol:
        made = BoundedProtocol(self._config, self._state, {}, loop)
        made.proxy_users, made.users = self._proxy_users, self._users
        return made

    async def close(self) -> None:
        """Stop, and end every connection."""
        for server in self._servers:
            server.close()
        for connection in list(self._state.connections):
            connection.transport.abort()
        for task in list(self._state.tasks):
            task.cancel()
        await asyncio.gather(*self._state.tasks, return_exceptions=True)
