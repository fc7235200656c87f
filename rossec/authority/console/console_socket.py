"""The console's socket: `ca/console.sock`, or where another user's console finds it. A shell.

Whoever may connect can read the record's names and take rights away, so it is the authority's own
user; one other may be named, whose socket is then outside of the directory of the key.
"""

import os
import pwd
from pathlib import Path
from typing import Final, NamedTuple

from rossec.authority.console import messages
from rossec.authority.console.admission import ConsolePeers
from rossec.authority.console.service import ConsoleService
from rossec.authority.keyservice.server import KeyServer, SocketRules
from rossec.errors import ConfigurationError

MAX_CALLERS: Final = 16


class ConsolePlace(NamedTuple):
    """Where the socket is, and which users may connect; none: the one of this process."""

    path: Path
    users: frozenset[int] = frozenset()


def place(directory: Path, path: Path | None, user: str | None) -> ConsolePlace:
    """Where the console of the authority in `directory` is: by default there.

    Raises:
        ConfigurationError: another user cannot come there, or could put a socket of their own.
    """
    if path is not None and path.exists() and not path.is_socket():
        raise ConfigurationError(
            f"{path} is a file, and not a socket", "choose another --console-socket"
        )
    if user is None:
        return ConsolePlace(path or directory / messages.SOCKET)
    try:
        number = pwd.getpwnam(user).pw_uid
    except KeyError:
        raise ConfigurationError(
            f"there is no user {user!a} on this host", "make one, or leave --console-user"
        ) from None
    if path is None:
        raise ConfigurationError(
            f"{user} cannot enter {directory}, where the socket would be",
            "name a directory for it: --console-socket /run/rossec/console.sock",
        )
    _check_directory(path.parent)
    return ConsolePlace(path, frozenset({os.geteuid(), number}))


def _check_directory(directory: Path) -> None:
    try:
        found = directory.stat()
    except OSError as error:
        raise ConfigurationError(
            f"{directory}: {error.strerror}", "make it, as the user of the service"
        ) from None
    if found.st_mode & 0o022 or found.st_uid not in {0, os.geteuid()}:
        raise ConfigurationError(
            f"another user could replace the socket in {directory}",
            "choose a directory of your own, which no other user can write",
        )


class ConsoleSocket:
    """Answers the console.

    Args:
        where: the socket.
        service: carries out what is asked.
        peers: is told who connects.
    """

    def __init__(self, where: ConsolePlace, service: ConsoleService, peers: ConsolePeers) -> None:
        rules = SocketRules(messages.read_request, messages.MAX_REQUEST, MAX_CALLERS, where.users)
        self._service = service
        self._server = KeyServer(where.path, service.carry_out, peers.remember, rules)

    async def start(self) -> None:
        """Listen; raises as `KeyServer.start`."""
        await self._server.start()

    async def close(self) -> None:
        """Stop listening, and end the threads."""
        await self._server.close()
        await self._service.close()
