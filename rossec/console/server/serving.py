"""uvicorn in this process's loop, with limits that it lacks: for what comes before a whole head.

No server header, no headers of a proxy read, no websockets. What cannot be read is not answered.
"""

import asyncio
import logging
import socket
import ssl
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from email.utils import formatdate
from functools import partial
from typing import Any, Final

from starlette.types import ASGIApp
from uvicorn.config import Config
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle
from uvicorn.server import ServerState

from rossec.errors import PeerUserRefused
from rossec.host import local_sockets
from rossec.host.runner import TaskSet
from rossec.net.aio.server import ACCEPT_PAUSE
from rossec.net.limits import HalfOpenCount, HalfOpenLimits, HalfOpenSlot

HEAD_TIME: Final = 15.0  # seconds for a request's head, from the connection or the answer before
MAX_HEAD: Final = 16 * 1024
KEEP_ALIVE: Final = 10  # seconds between two requests
PLACE: Final = "rossec.place"  # in a request's scope: the place of its connection
_ACCEPTS_PER_TURN: Final = 16
STRANGERS: Final = HalfOpenLimits(per_address=64, total=256)  # a browser has six, and a page one for news
SESSIONS: Final = HalfOpenLimits(per_address=32, total=128)  # of one phone, or of one session to look
OTHER_USERS: Final = HalfOpenLimits(per_address=8, total=8)  # of this host; they are told, and no more
PROXIES: Final = HalfOpenLimits(per_address=256, total=256)  # at a unix socket, where all have no address
_HINT: Final = "open it in a browser of the user who started the console"
_log = logging.getLogger("rossec.console")


def check_peer(scope: Mapping[str, Any], users: frozenset[int] | None) -> None:
    """Return if the connection of a request may be used; `users` None: anybody's may."""
    # Cookies know no ports, and every user of a host reaches every port of it; so the user of the TCP peer is
    # looked up for each request. Root is refused like any other user unless the console runs as root: it
    # could take what it wants anyway, and a browser run as root by mistake should not.
    if users is None:
        return
    client, server = scope.get("client"), scope.get("server")
    if not client or not server or server[1] is None:
        raise PeerUserRefused("nobody knows whose connection this is", _HINT)
    try:
        holder = local_sockets.find_holder((client[0], client[1]), (server[0], server[1]))
    except OSError as error:
        raise PeerUserRefused("nobody knows whose connection this is", _HINT) from error
    if holder is None or holder.user not in users or not local_sockets.is_known(holder.user):
        raise PeerUserRefused("this console belongs to another user of this computer", _HINT)


class ConnectionPlace:
    def __init__(self, slot: HalfOpenSlot, sessions: HalfOpenCount) -> None:
        self._slot = slot
        self._sessions = sessions
        self._owner = ""

    def closed_by(self, close: Callable[[], None]) -> None:
        self._slot.close = close

    def belongs_to(self, owner: str) -> None:
        if owner == self._owner:
            return
        slot = self._sessions.admit(owner)
        if slot is not None:
            slot.close = self._slot.close
            self._slot.release()
            self._slot, self._owner = slot, owner

    def release(self) -> None:
        self._slot.release()


class ConnectionShares:
    """The places of the console's connections: shares by source, then by who is logged in."""

    # A connection takes one when it is accepted, before TLS begins, and keeps it until it is closed. Where
    # all are taken, one of the source that has most makes room (`rossec.net.limits`). One on which a session
    # was shown moves to the places of sessions: strangers end none of those (console-connections).

    def __init__(self) -> None:
        self._strangers = HalfOpenCount(STRANGERS)
        self._sessions = HalfOpenCount(SESSIONS)
        self._other_users = HalfOpenCount(OTHER_USERS)
        self._proxies = HalfOpenCount(PROXIES)

    def __len__(self) -> int:
        return sum(map(len, (self._strangers, self._sessions, self._other_users, self._proxies)))

    def take(self, address: str, *, is_other_user: bool) -> ConnectionPlace | None:
        others = self._strangers if address else self._proxies
        count = self._other_users if is_other_user else others
        slot = count.admit(address)
        return None if slot is None else ConnectionPlace(slot, self._sessions)


class BoundedProtocol(H11Protocol):
    _deadline: asyncio.TimerHandle | None = None
    place: ConnectionPlace | None = None
    has_begun = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.has_begun = True
        if self.place is not None:
            self.place.closed_by(transport.abort)
            app, place = self.app, self.place
            self.app = lambda scope, receive, send: app({**scope, PLACE: place}, receive, send)
        self._arm()

    def data_received(self, data: bytes) -> None:
        date = formatdate(usegmt=True).encode()  # RFC 9110 section 6.6.1
        self.server_state.default_headers = [(b"date", date)]
        super().data_received(data)
        if self._is_answering:
            self._disarm()

    def on_response_complete(self) -> None:
        self._arm()
        super().on_response_complete()
        if self._is_answering:  # it was there already
            self._disarm()

    def connection_lost(self, exc: Exception | None) -> None:
        self._disarm()
        if self.place is not None:
            self.place.release()
        super().connection_lost(exc)

    def send_400_response(self, msg: str) -> None:
        # Close instead: such an answer would lack the headers that all have.
        del msg
        self.transport.abort()

    @property
    def _is_answering(self) -> bool:
        cycle: RequestResponseCycle | None = self.cycle  # None before the first request
        return cycle is not None and not cycle.response_complete

    # For every request's head: nobody holds a connection by sending a byte a minute.
    def _arm(self) -> None:
        self._disarm()
        self._deadline = self.loop.call_later(HEAD_TIME, self.transport.abort)

    def _disarm(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


class ConsoleServer:
    """Serves `app` at sockets that listen, with TLS if it has a `context`.

    `proxy_users` may connect at a unix socket, `users` over TCP (None: anybody).
    """

    def __init__(
        self,
        app: ASGIApp,
        context: ssl.SSLContext | None = None,
        proxy_users: frozenset[int] = frozenset(),
        users: frozenset[int] | None = None,
    ) -> None:
        self._config = Config(
            app,
            http=BoundedProtocol,
            ws="none",
            lifespan="off",
            interface="asgi3",
            log_config=None,  # and no access log: a path can name a robot
            access_log=False,
            # Anybody can send `X-Forwarded-For`: an address is what the kernel says, or none.
            proxy_headers=False,
            server_header=False,
            timeout_keep_alive=KEEP_ALIVE,
            h11_max_incomplete_event_size=MAX_HEAD,
        )
        self._config.load()
        self._state = ServerState()
        self._context = context
        self._proxy_users, self._users = proxy_users, users
        self._listening: list[socket.socket] = []
        self._beginning = TaskSet()
        self.places = ConnectionShares()

    async def start(self, sockets: Iterable[socket.socket]) -> None:
        for sock in sockets:
            sock.setblocking(False)
            self._listening.append(sock)
            self._add_reader(sock)

    def _add_reader(self, listening: socket.socket) -> None:
        if listening in self._listening:  # it was not closed meanwhile
            asyncio.get_running_loop().add_reader(listening.fileno(), self._accept, listening)

    def _accept(self, listening: socket.socket) -> None:
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
            place.closed_by(partial(_shut_down, sock))
            self._beginning.spawn(self._begin(sock, place), name="a connection of the console")

    def _place_for(self, sock: socket.socket, where: Any) -> ConnectionPlace | None:
        if sock.family == socket.AF_UNIX:  # a proxy
            try:
                local_sockets.require_user(sock, self._proxy_users)
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

    async def _begin(self, sock: socket.socket, place: ConnectionPlace) -> None:
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


def _shut_down(sock: socket.socket) -> None:
    # Not closed: the task that begins on it still uses its descriptor.
    with suppress(OSError):
        sock.shutdown(socket.SHUT_RDWR)
