"""Accepting secure connections with blocking sockets.

`accept` returns before the handshake: a slow caller blocks only its own thread, and counts as
half-open until it is authenticated or closed.
"""

import secrets
import socket
from typing import Any, Generic

from rossec import clock
from rossec.channel.connection import Connection
from rossec.channel.edhoc.credentials import OwnCredential, PeerT, Verify
from rossec.net.halfopen import HalfOpen, HalfOpenCount
from rossec.net.threads.secure_socket import SecureSocket


class SecureListener(Generic[PeerT]):
    """A listening socket whose connections are secure; `options` are `Connection.responder`'s."""

    def __init__(
        self,
        sock: socket.socket,
        credentials: OwnCredential,
        verify: Verify[PeerT],
        *,
        half_open: HalfOpen = HalfOpen(),  # noqa: B008 - frozen
        **options: Any,
    ) -> None:
        self._socket = sock
        self._credentials = credentials
        self._verify: Verify[PeerT] = verify
        self._options = options
        self._count = HalfOpenCount(half_open)

    def accept(self) -> tuple[SecureSocket[PeerT], Any]:
        """Return the next connection and its address; callers over the limits are dropped.

        Raises:
            OSError: as `socket.socket`.
        """
        while True:
            sock, where = self._socket.accept()
            place = self._count.admit(where[0])
            if place is not None:
                break
            sock.close()
        place.bind(sock)
        core = Connection.responder(
            self._credentials,
            self._verify,
            random=secrets.token_bytes,
            now=clock.now(),
            **self._options,
        )
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
