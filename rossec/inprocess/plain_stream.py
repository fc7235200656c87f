"""A plain connection that `allow_plain` names, with the interface of a secure one.

Also here: reading what a caller sends first without consuming it, so that a caller that is not
named continues with the handshake, which refuses it.
"""

import socket
import struct
import time
from typing import Any, Final

from rossec.channel.opening import MAX_DRAIN, PlainCaller, classify_caller
from rossec.errors import HeaderRefused, ProtocolViolation
from rossec.ros import header

_READ: Final = 256 * 1024
_PREFIX: Final = 4
DEADLINE: Final = 5.0


class PlainStream:
    """What is used of a `SecureSocket`; the peer is not authenticated."""

    peer = None
    awaits_peer = False

    def __init__(self, sock: socket.socket) -> None:
        sock.settimeout(None)
        self._socket = sock

    def recv(self, size: int) -> bytes:
        """As `socket.socket`."""
        return self._socket.recv(size)

    def recv_into(self, buffer: bytearray | memoryview, size: int = 0) -> int:
        """As `socket.socket`."""
        return self._socket.recv_into(buffer, size)

    def receive_unit(self) -> bytes:
        """What has arrived."""
        return self._socket.recv(_READ)

    def pump(self) -> None:
        """Nothing to receive."""

    def sendall(self, *pieces: bytes | bytearray | memoryview) -> None:
        """Send the pieces."""
        for piece in pieces:
            self._socket.sendall(piece)

    def settimeout(self, value: float | None) -> None:
        """As `socket.socket`."""
        self._socket.settimeout(value)

    def gettimeout(self) -> float | None:
        """As `socket.socket`."""
        return self._socket.gettimeout()

    def shutdown(self, how: int = socket.SHUT_RDWR) -> None:
        """As `socket.socket`."""
        self._socket.shutdown(how)

    def close(self) -> None:
        """As `socket.socket`."""
        self._socket.close()


def peek(sock: socket.socket) -> bytes:
    """The first bytes of a plain caller, not consumed: a whole connection header, or the beginning
    of an HTTP request; empty for any other caller, and for one that sends nothing in time.
    """
    try:
        return _first(sock)
    except OSError:
        return b""
    finally:
        sock.settimeout(None)


def _first(sock: socket.socket) -> bytes:
    end = time.monotonic() + DEADLINE
    first = _peek_bytes(sock, _PREFIX, end)
    try:
        verdict = classify_caller(first + b"\0" * 60)
    except ProtocolViolation:
        return b""
    if first in (b"POST", b"GET "):
        return first
    if not isinstance(verdict, PlainCaller) or verdict.drain > MAX_DRAIN:
        return b""
    return _peek_bytes(sock, min(verdict.drain, _PREFIX + header.HEADER_LIMIT), end)


def plain_fields(data: bytes) -> dict[str, bytes]:
    """The fields of a plain caller's connection header; empty if it is invalid."""
    if len(data) < _PREFIX or struct.unpack_from("<I", data)[0] != len(data) - _PREFIX:
        return {}
    try:
        return header.decode(data[_PREFIX:])
    except HeaderRefused:
        return {}


def _peek_bytes(sock: socket.socket, size: int, end: float) -> bytes:
    """`size` bytes, or those that came in time."""
    data: Any = b""
    while len(data) < size and (left := end - time.monotonic()) > 0:
        sock.settimeout(left)
        peeked = sock.recv(size, socket.MSG_PEEK)
        if len(peeked) == len(data):
            if not peeked:
                break
            time.sleep(0.005)  # the kernel cannot wait for more than has arrived
        data = peeked
    return bytes(data)
