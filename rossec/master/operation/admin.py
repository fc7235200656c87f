"""The administrator's local port of a master or a relay: a Unix socket.

A shell. The socket is in its own directory (0600), and the kernel reports the user of the peer:
only the user who runs it, and root, are admitted. A master's is off unless enabled. A connection is
one request and one answer, each a line of JSON. No command changes a right.
"""

import asyncio
import json
import logging
import os
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from rossec.errors import ConfigurationError, PeerUserRefused
from rossec.master.operation.denial_limit import DENIALS
from rossec.net.host.peeruid import require_user
from rossec.operation.unix_socket import listen_at, raw_socket

DEADLINE: Final = 5.0
_MAX_LINE: Final = 1024
_HINTS: Final = {
    "master": "is it running? rossec master --admin, or `admin: true` in its configuration"
}
_audit = logging.getLogger("rossec.audit")
_denials = logging.getLogger(DENIALS)

Commands = Mapping[str, Callable[[], Mapping[str, Any]]]


class AdminPort:
    """Listens at `path` for the names of `commands`."""

    def __init__(self, path: Path, commands: Commands) -> None:
        self._path = path
        self._commands = commands
        self._server: asyncio.Server | None = None

    async def start(self) -> None:
        """Listen; a stale socket of a killed master is replaced.

        Raises:
            ConfigurationError: another master listens there, or the path is too long.
        """
        if self._path.exists():
            with socket.socket(socket.AF_UNIX) as probe:
                if probe.connect_ex(str(self._path)) == 0:
                    raise ConfigurationError(f"another program listens at {self._path}")
            self._path.unlink()
        sock = listen_at(self._path)
        self._server = await asyncio.start_unix_server(self._handle, sock=sock, limit=_MAX_LINE)

    async def close(self) -> None:
        """Stop listening."""
        if self._server is not None:
            self._server.close()
            self._path.unlink(missing_ok=True)

    async def _handle(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            with suppress(
                TimeoutError, OSError, ValueError, RecursionError, asyncio.IncompleteReadError
            ):
                async with asyncio.timeout(DEADLINE):
                    await self._answer(reader, writer)
        finally:
            writer.close()

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        sock = writer.get_extra_info("socket")
        try:
            user = require_user(raw_socket(sock), {os.geteuid(), 0})
        except (PeerUserRefused, OSError) as error:
            _denials.warning("refused at the administrator's port: %s", error)
            return
        command = json.loads(await reader.readuntil(b"\n"))
        action = self._commands.get(command) if isinstance(command, str) else None
        if action is None:
            answer: Mapping[str, Any] = {"error": "unknown command"}
        else:
            _audit.info("user %d asks for %s", user, command)
            answer = action()
        writer.write(json.dumps(answer).encode() + b"\n")
        await writer.drain()


def send_command(path: Path, command: str, what: str = "master") -> dict[str, Any]:
    """Send a command to the master, or relay, that listens at `path`.

    Raises:
        ConfigurationError: nobody answers, or with an error.
    """
    hint = _HINTS.get(what, f"is it running? rossec {what}")
    try:
        with socket.socket(socket.AF_UNIX) as sock:
            sock.settimeout(DEADLINE)
            sock.connect(str(path))
            sock.sendall(json.dumps(command).encode() + b"\n")
            with sock.makefile("rb") as file:
                answer = json.loads(file.readline(1 << 20) or b"null")
    except (OSError, ValueError) as error:
        reason = (isinstance(error, OSError) and error.strerror) or error
        raise ConfigurationError(f"the {what} does not answer at {path}: {reason}", hint) from error
    if not isinstance(answer, dict) or "error" in answer:
        raise ConfigurationError(f"the {what} refused", hint)
    return answer
