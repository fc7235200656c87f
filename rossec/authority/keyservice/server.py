"""A socket of the service: `ca/service.sock`, for the user of the authority alone. A shell.

Every connection is one caller, admitted by the user id that the kernel reports. It may send any
number of requests, one after the other. Its number of connections, the size of a message and the
time for one are bounded; what is malformed is answered with a refusal and ends the connection.
"""

import asyncio
import logging
import os
import socket
from collections.abc import Awaitable, Callable, Collection
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

from ca.encoding import Value
from ca.errors import HintedError
from rossec.authority.keyservice import messages
from rossec.authority.keyservice.caller import Caller, caller_of
from rossec.authority.keyservice.messages import Request
from rossec.errors import KeyMessageRefused, KeyServiceRefused, PeerUserRefused
from rossec.net.host.peeruid import UnixPeer, require_user, unix_peer
from rossec.operation.unix_socket import listen_at, raw_socket

MAX_CALLERS: Final = 64
IDLE: Final = 120.0  # seconds between two requests of a caller
DEADLINE: Final = 10.0  # seconds from the first byte of a request to its last, and for an answer
_log = logging.getLogger("rossec.authority.service")

CarryOut = Callable[[Request, Caller], Awaitable[Value]]


def admit_all(_: UnixPeer) -> None:
    """Admit every process of the user."""


class SocketRules(NamedTuple):
    """What a socket takes, and from whom.

    Args:
        read_request: reads the body of a frame. Raises `KeyMessageRefused`.
        max_request: bytes of the body.
        max_callers: connections at a time.
        users: who may connect; empty: the user of this process.
    """

    read_request: Callable[[bytes], Request] = messages.read_request
    max_request: int = messages.MAX_FRAME
    max_callers: int = MAX_CALLERS
    users: Collection[int] = ()


KEY_RULES: Final = SocketRules()


class KeyServer:
    """Listens at `path`.

    Args:
        path: of the socket; a stale one is replaced, so the caller holds the lock of the service.
        carry_out: carries out one request. Raises `HintedError` for a refusal.
        admit: raises `PeerUserRefused` for a process that may not ask.
        rules: of the socket.
    """

    def __init__(
        self,
        path: Path,
        carry_out: CarryOut,
        admit: Callable[[UnixPeer], None] = admit_all,
        rules: SocketRules = KEY_RULES,
    ) -> None:
        self._path = path
        self._carry_out = carry_out
        self._admit = admit
        self._rules = rules
        self._server: asyncio.Server | None = None
        self._callers: set[asyncio.StreamWriter] = set()

    async def start(self) -> None:
        """Listen.

        Raises:
            ConfigurationError: the path is too long.
        """
        self._path.unlink(missing_ok=True)
        self._server = await asyncio.start_unix_server(
            self._serve, sock=self._listen(), limit=self._rules.max_request
        )

    def _listen(self) -> socket.socket:
        sock = listen_at(self._path)
        if self._rules.users:
            self._path.chmod(0o666)  # the directory, and who connects, decide
        return sock

    async def close(self) -> None:
        """Stop listening, and end every connection."""
        if self._server is not None:
            self._server.close()
            self._path.unlink(missing_ok=True)
        for writer in self._callers:
            writer.transport.abort()
        await asyncio.sleep(0)  # the sockets are closed by then

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._callers.add(writer)
        try:
            with suppress(TimeoutError, OSError, asyncio.IncompleteReadError):
                await self._answer_all(reader, writer)
        except Exception:  # noqa: BLE001 - a check that crashes closes the connection
            _log.exception("a connection to the service ended")
        finally:
            self._callers.discard(writer)
            writer.transport.abort()

    async def _answer_all(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        caller = self._admitted(writer)
        if len(self._callers) > self._rules.max_callers:
            busy = KeyServiceRefused(
                f"{self._rules.max_callers} programs use the authority's service now", "try again"
            )
            await _send(writer, messages.write_refusal(busy))
            return
        while True:
            async with asyncio.timeout(IDLE):
                first = await reader.readexactly(1)
            try:
                async with asyncio.timeout(DEADLINE):
                    body = await _read_frame(reader, first, self._rules.max_request)
                    request = self._rules.read_request(body)
            except KeyMessageRefused as error:
                await _send(writer, messages.write_refusal(error))
                return
            await _send(writer, await self._answer(request, caller))

    def _admitted(self, writer: asyncio.StreamWriter) -> Caller:
        """Who is at the other end, if it may ask.

        Raises:
            OSError: it may not; it gets no answer.
        """
        try:
            sock = raw_socket(writer.get_extra_info("socket"))
            require_user(sock, self._rules.users or {os.geteuid()})
            peer = unix_peer(sock)
            self._admit(peer)
        except PeerUserRefused as error:
            _log.warning("refused at the authority's service: %s", error)
            raise OSError("refused") from error
        return caller_of(peer)

    async def _answer(self, request: Request, caller: Caller) -> bytes:
        try:
            return messages.write_answer(await self._carry_out(request, caller))
        except HintedError as error:
            return messages.write_refusal(error)


async def _read_frame(reader: asyncio.StreamReader, first: bytes, limit: int) -> bytes:
    head = first + await reader.readexactly(messages.HEAD - 1)
    return await reader.readexactly(messages.frame_size(head, limit))


async def _send(writer: asyncio.StreamWriter, data: bytes) -> None:
    writer.write(data)
    async with asyncio.timeout(DEADLINE):
        await writer.drain()
