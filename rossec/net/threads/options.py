"""The socket methods that move no bytes: time-outs, options, addresses."""

import socket
from typing import Any


class SocketOptions:
    """What `SecureSocket` passes on to its TCP socket, and its own time-out."""

    _socket: socket.socket
    _timeout: float | None

    def settimeout(self, value: float | None) -> None:
        """As of sockets: None waits, 0 does not."""
        self._timeout = value

    def gettimeout(self) -> float | None:
        """What `settimeout` set."""
        return self._timeout

    def setblocking(self, flag: bool) -> None:
        """As of sockets."""
        self._timeout = None if flag else 0.0

    def setsockopt(self, *arguments: Any) -> None:
        """Set an option of the TCP socket."""
        self._socket.setsockopt(*arguments)

    def getsockopt(self, *arguments: Any) -> int | bytes:
        """Return an option of the TCP socket."""
        return self._socket.getsockopt(*arguments)

    def getsockname(self) -> Any:
        """This side's address."""
        return self._socket.getsockname()

    def getpeername(self) -> Any:
        """The peer's address: for logs, never for trust."""
        return self._socket.getpeername()
