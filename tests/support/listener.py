"""Accepting secure connections with blocking sockets.

`accept` returns before the handshake: a slow caller blocks only its own thread, and counts as
half-open until it is authenticated or closed.
"""

import socket
from typing import Any, Generic

from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.opening import WireProtocol
from rossec.net.context import SecureContext
from rossec.net.threads.secure_socket import SecureSocket


class SecureListener(Generic[PeerT]):
    """A listening socket whose connections are secure."""

    def __init__(self, sock: socket.socket, context: SecureContext[PeerT]) -> None:
        self._socket = sock
        self._context = context

    def accept(self) -> tuple[SecureSocket[PeerT], Any]:
        """Return the next connection and its address; callers over the limits are dropped.

        Raises:
            OSError: as `socket.socket`.
        """
        while True:
            sock, where = self._socket.accept()
            place = self._context.half_open.admit(where[0])
            if place is not None:
                break
            sock.close()
        place.bind(sock)
        core = self._context.responder(WireProtocol.TCPROS)
        return SecureSocket(sock, core, place.release), where

    def fileno(self) -> int:
        """The descriptor to wait on."""
        return self._socket.fileno()

    def settimeout(self, value: float | None) -> None:
        """How long `accept` waits."""
        self._socket.settimeout(value)

    def setsockopt(self, *arguments: Any) -> None:
        """Set an option of the TCP socket."""
        self._socket.setsockopt(*arguments)

    def getsockname(self) -> Any:
        """The address it listens on."""
        return self._socket.getsockname()

    def shutdown(self, how: int) -> None:
        """As `socket.socket`: a blocked `accept` returns."""
        self._socket.shutdown(how)

    def close(self) -> None:
        """Stop listening."""
        self._socket.close()

    def __enter__(self) -> "SecureListener[PeerT]":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
