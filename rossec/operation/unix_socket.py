"""A unix socket of one's own: in a directory of its owner, who alone may connect (0600)."""

import os
import socket
from pathlib import Path
from typing import Final

from rossec.errors import ConfigurationError, PeerUserRefused

MAX_PATH: Final = 107  # bytes, unix(7)


def listen_at(path: Path, backlog: int = 100) -> socket.socket:
    """Listen at `path`, where no file is; the caller removes a stale socket, under its lock.

    Raises:
        ConfigurationError: the path is too long.
        OSError: the path exists, or cannot be made.
    """
    if len(os.fsencode(path)) > MAX_PATH:
        raise ConfigurationError(
            f"{path} is too long for the path of a socket: at most {MAX_PATH} bytes",
            "choose a shorter ROSSEC_HOME",
        )
    sock = socket.socket(socket.AF_UNIX)
    before = os.umask(0o177)
    try:
        sock.bind(str(path))
        sock.listen(backlog)
    except BaseException:
        sock.close()
        raise
    finally:
        os.umask(before)
    return sock


def raw_socket(sock: object) -> socket.socket:
    """The socket behind asyncio's TransportSocket, which lacks methods.

    Raises:
        PeerUserRefused: there is none, so nobody knows who is there.
    """
    found = getattr(sock, "_sock", sock)
    if not isinstance(found, socket.socket):
        raise PeerUserRefused("the connection has no socket")
    return found
