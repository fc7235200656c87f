"""The kernel's answer to "who holds this TCP socket?" for one socket: NETLINK_SOCK_DIAG.

The same data as in /proc/net/tcp, whose text grows with every connection in TIME_WAIT; here the
kernel looks one connection up in its own table, and finds the listener by the rules of connect().
The format is that of sock_diag(7). An IPv4 connection is found whichever family its sockets have.
Not every kernel has it (gVisor, old containers): callers must fall back to the tables.
"""

import errno
import ipaddress
import os
import socket
import struct
from typing import Final, NamedTuple

ESTABLISHED: Final = 1
LISTEN: Final = 10
_SOCK_DIAG: Final = 4  # NETLINK_SOCK_DIAG, and SOCK_DIAG_BY_FAMILY below
_BY_FAMILY: Final = 20
_ERROR: Final = 2
_ASK: Final = 0x1  # NLM_F_REQUEST
_ROOM: Final = 64 * 1024
_HEAD: Final = struct.Struct("=IHHII")  # nlmsghdr
_WHAT: Final = struct.Struct("=BBBBI")  # family, protocol, extensions, padding, states
_PORTS: Final = struct.Struct("!HH")
_ANY_COOKIE: Final = struct.pack("=III", 0, 0xFFFFFFFF, 0xFFFFFFFF)  # and no interface
_FOUND: Final = struct.Struct("=BB2x4s16s16s12x12xII")  # inet_diag_msg


class SocketEntry(NamedTuple):
    """One socket: its state, the user who created it, its inode (0: no process holds it)."""

    state: int
    local: tuple[bytes, int]
    remote: tuple[bytes, int]
    user: int
    inode: int


def find(local: tuple[str, int], remote: tuple[str, int]) -> SocketEntry | None:
    """The socket that is bound to `local` and connected to `remote`; None: there is none.

    Raises:
        OSError: the kernel cannot answer.
    """
    ends = _packed(local), _packed(remote)
    entry = _found(*ends)
    if entry is None or entry.state != ESTABLISHED:  # the kernel falls back to a listener
        return None
    return entry if (_plain(entry.local), _plain(entry.remote)) == ends else None


def listener(local: tuple[str, int]) -> SocketEntry | None:
    """The socket that a connection to `local` would reach; None: there is none.

    Raises:
        OSError: the kernel cannot answer.
    """
    entry = _found(_packed(local), _packed((local[0], 0)))  # no connection is from port 0
    return entry if entry is not None and entry.state == LISTEN else None


def _found(local: tuple[bytes, int], remote: tuple[bytes, int]) -> SocketEntry | None:
    family = socket.AF_INET if len(local[0]) == 4 else socket.AF_INET6
    try:
        return _ask(_request(family, local, remote))
    except FileNotFoundError:
        return None


def _request(family: int, local: tuple[bytes, int], remote: tuple[bytes, int]) -> bytes:
    body = (
        _WHAT.pack(family, socket.IPPROTO_TCP, 0, 0, 1 << ESTABLISHED)
        + _PORTS.pack(local[1], remote[1])
        + local[0].ljust(16, b"\0")
        + remote[0].ljust(16, b"\0")
        + _ANY_COOKIE
    )
    return _HEAD.pack(_HEAD.size + len(body), _BY_FAMILY, _ASK, 1, 0) + body


def _ask(request: bytes) -> SocketEntry:
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, _SOCK_DIAG) as kernel:
        kernel.send(request)
        data, (sender, *_) = kernel.recvfrom(_ROOM)
        if sender != 0:  # another process, which would need to be privileged: not the kernel
            raise OSError(errno.EPROTO, "an answer from another process")
        return parse(data)


def parse(data: bytes) -> SocketEntry:
    """The socket in an answer. Pure.

    Raises:
        OSError: the kernel's error, or an invalid answer.
    """
    if len(data) < _HEAD.size:
        raise OSError(errno.EPROTO, "an answer cut short")
    length, kind, *_ = _HEAD.unpack_from(data)
    if not _HEAD.size <= length <= len(data):
        raise OSError(errno.EPROTO, "an answer cut short")
    body = data[_HEAD.size : length]
    if kind == _ERROR and len(body) >= 4:
        number = -struct.unpack_from("=i", body)[0]
        raise OSError(number, os.strerror(number))
    if kind != _BY_FAMILY or len(body) < _FOUND.size:
        raise OSError(errno.EPROTO, "an answer of another kind")
    return _entry(body)


def _entry(body: bytes) -> SocketEntry:
    family, state, ports, local, remote, user, inode = _FOUND.unpack_from(body)
    size = 4 if family == socket.AF_INET else 16
    local_port, remote_port = _PORTS.unpack(ports)
    return SocketEntry(state, (local[:size], local_port), (remote[:size], remote_port), user, inode)


def _packed(end: tuple[str, int]) -> tuple[bytes, int]:
    return _plain((ipaddress.ip_address(end[0].partition("%")[0]).packed, end[1]))


def _plain(end: tuple[bytes, int]) -> tuple[bytes, int]:
    """A mapped IPv4 address as IPv4."""
    address, port = end
    mapped = len(address) == 16 and address.startswith(bytes(10) + b"\xff\xff")
    return (address[12:] if mapped else address), port
