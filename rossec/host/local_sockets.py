"""Local sockets: a lock and a unix socket of one's own, and which user is at the other end of a connection in
this host.

For a unix socket the kernel says so (SO_PEERCRED); for TCP over loopback its socket table does, queried for
the one connection (NETLINK_SOCK_DIAG), or read as a whole where that is not available (gVisor, old
containers). A TCP row counts only while it is ESTABLISHED and has an inode: the kernel shows user 0 for
sockets that no process holds any more (TIME_WAIT, closed, not yet accepted), which must not pass for root's.
Users of another user namespace all show as the overflow id, which identifies none: refused. The user is the
creator of the socket: a program that passes its open socket to another one, or a set-user-id program that
connects on behalf of its caller, is responsible for it.
"""

import errno
import ipaddress
import os
import socket
import struct
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

from rossec import files
from rossec.errors import ConfigurationError, PeerUserRefused

Endpoint: TypeAlias = tuple[str, int]
"""An IP address and a port."""

MAX_PATH: Final = 107  # bytes, unix(7)
TABLES: Final = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))
OVERFLOW: Final = Path("/proc/sys/kernel/overflowuid")
_ESTABLISHED: Final = "01"
_LISTEN: Final = " 0A"
_TRIES: Final = 3  # the kernel returns the table in pieces: a row can be missed between two of them
_HINT: Final = "connect from this host, as the user who runs this program"

# As sock_diag(7) has it:
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


@contextmanager
def process_lock(path: Path, busy: ConfigurationError) -> Iterator[None]:
    descriptor = files.lock_file(path, busy)
    try:
        yield
    finally:
        os.close(descriptor)


def listen_at(path: Path, backlog: int = 100) -> socket.socket:
    """Listen at `path`, where no file is; the caller removes a stale socket, under its lock."""
    if len(os.fsencode(path)) > MAX_PATH:
        raise ConfigurationError(
            f"{path} is too long for the path of a socket: at most {MAX_PATH} bytes",
            "choose a shorter ROSSEC_HOME",
        )
    sock = socket.socket(socket.AF_UNIX)
    # The mode is that of bind(): a socket that was open to others until chmod() could be connected meanwhile.
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
    """The socket behind asyncio's TransportSocket, which lacks methods."""
    found = getattr(sock, "_sock", sock)
    if not isinstance(found, socket.socket):
        raise PeerUserRefused("the connection has no socket")
    return found


class Holder(NamedTuple):
    """The holder of a socket: the user who created it, and the socket's inode."""

    user: int
    inode: int


def holder_in(tables: Iterable[str], local: Endpoint, remote: Endpoint) -> Holder | None:
    """The holder of the socket bound to `local` and connected to `remote`; None: none. Pure.

    `tables` are the texts of /proc/net/tcp and tcp6. An IPv4 address matches in its mapped form
    too (::ffff:127.0.0.1): either side may use a dual-stack socket.
    """
    # Both forms of an IPv4 address: either side may use a dual-stack socket.
    wanted = {f"{_hex(local, mapped)} {_hex(remote, mapped)} {_ESTABLISHED}" for mapped in (0, 1)}
    found = [holder for row, holder in _rows(tables) if row in wanted]
    return found[0] if len({holder.user for holder in found}) == 1 else None


def listeners_in(tables: Iterable[str], endpoint: Endpoint) -> list[Holder]:
    address, port = endpoint
    wanted = {_hex(endpoint, 0), _hex(endpoint, 1), _hex(("::", port), 0)}
    if ":" not in address:
        wanted.add(_hex(("0.0.0.0", port), 0))  # noqa: S104 - looked for
    return [
        holder for row, holder in _rows(tables) if row.endswith(_LISTEN) and row.partition(" ")[0] in wanted
    ]


def _rows(tables: Iterable[str]) -> Iterator[tuple[str, Holder]]:
    for table in tables:
        for line in table.splitlines()[1:]:
            fields = line.split()
            if len(fields) > 9 and fields[9] != "0":
                yield " ".join(fields[1:4]), Holder(int(fields[7]), int(fields[9]))


def tables() -> list[str]:
    return [path.read_text() for path in TABLES if path.exists()]


class UnixPeer(NamedTuple):
    """The other end of a unix socket: the process that connected it or listened, and its user. The number of
    a process that has ended may be given to another one: it identifies nobody."""

    process: int
    user: int


def unix_peer(sock: socket.socket) -> UnixPeer:
    """The other end of a connected unix socket (SO_PEERCRED, unix(7))."""
    size = struct.calcsize("3i")
    credentials = sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size)
    process, user, _ = struct.unpack("3i", credentials)
    return UnixPeer(process, user)


def user_of(sock: socket.socket) -> int:
    if sock.family == socket.AF_UNIX:
        return unix_peer(sock).user
    return holder_of(sock).user


def holder_of(sock: socket.socket) -> Holder:
    local, remote = sock.getpeername()[:2], sock.getsockname()[:2]
    holder = find_holder(local, remote)
    if holder is not None:
        return holder
    raise PeerUserRefused("the other end of the connection belongs to no program here", _HINT)


def find_holder(local: Endpoint, remote: Endpoint) -> Holder | None:
    """The holder of the socket bound to `local` and connected to `remote`; None: no program."""
    try:
        entry = find(local, remote)
    except OSError:
        for _ in range(_TRIES):
            holder = holder_in(tables(), local, remote)
            if holder is not None:
                return holder
        return None
    return None if entry is None or entry.inode == 0 else Holder(entry.user, entry.inode)


def listeners(endpoint: Endpoint) -> list[Holder]:
    """The holders of sockets that listen on `endpoint`, an address of this host. At most one, unless only the
    tables are available: then all candidates."""
    try:
        entry = listener(endpoint)
    except OSError:
        return listeners_in(tables(), endpoint)
    return [] if entry is None or entry.inode == 0 else [Holder(entry.user, entry.inode)]


def is_known(user: int) -> bool:
    """Whether `user` is not the overflow id, which stands for other user namespaces."""
    return user != int(OVERFLOW.read_text())


def require_user(sock: socket.socket, users: Collection[int]) -> int:
    user = user_of(sock)
    # The overflow id stands for every user of other namespaces, so it is nobody, also when it is on the list.
    if user not in users or not is_known(user):
        raise PeerUserRefused(f"user {user} may not use this connection", _HINT)
    return user


def _hex(endpoint: Endpoint, mapped: int) -> str:
    address = ipaddress.ip_address(endpoint[0].partition("%")[0])
    plain = getattr(address, "ipv4_mapped", None) or address
    packed: bytes = plain.packed
    if mapped and len(packed) == 4:
        packed = bytes(10) + b"\xff\xff" + packed
    words = struct.unpack(f"={len(packed) // 4}I", packed)
    return "".join(f"{word:08X}" for word in words) + f":{endpoint[1]:04X}"


# The kernel's answer to "who holds this TCP socket?" for one socket: the same data as in /proc/net/tcp, whose
# text grows with every connection in TIME_WAIT; here the kernel looks one up, and finds the listener by the
# rules of connect(). An IPv4 connection is found whichever family its sockets have.


class SocketEntry(NamedTuple):
    state: int
    local: tuple[bytes, int]
    remote: tuple[bytes, int]
    user: int
    inode: int


def find(local: Endpoint, remote: Endpoint) -> SocketEntry | None:
    """The socket that is bound to `local` and connected to `remote`; None: there is none."""
    ends = _packed(local), _packed(remote)
    entry = _found(*ends)
    if entry is None or entry.state != ESTABLISHED:  # the kernel falls back to a listener
        return None
    return entry if (_plain(entry.local), _plain(entry.remote)) == ends else None


def listener(local: Endpoint) -> SocketEntry | None:
    """The socket that a connection to `local` would reach; None: there is none."""
    entry = _found(_packed(local), _packed((local[0], 0)))  # no connection is from port 0
    return entry if entry is not None and entry.state == LISTEN else None


def _found(local: tuple[bytes, int], remote: tuple[bytes, int]) -> SocketEntry | None:
    family = socket.AF_INET if len(local[0]) == 4 else socket.AF_INET6
    body = (
        _WHAT.pack(family, socket.IPPROTO_TCP, 0, 0, 1 << ESTABLISHED)
        + _PORTS.pack(local[1], remote[1])
        + local[0].ljust(16, b"\0")
        + remote[0].ljust(16, b"\0")
        + _ANY_COOKIE
    )
    try:
        return _ask(_HEAD.pack(_HEAD.size + len(body), _BY_FAMILY, _ASK, 1, 0) + body)
    except FileNotFoundError:
        return None


def _ask(request: bytes) -> SocketEntry:
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, _SOCK_DIAG) as kernel:
        kernel.send(request)
        data, (sender, *_) = kernel.recvfrom(_ROOM)
        if sender != 0:  # another process, which would need to be privileged: not the kernel
            raise OSError(errno.EPROTO, "an answer from another process")
        return parse(data)


def parse(data: bytes) -> SocketEntry:
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
    family, state, ports, local, remote, user, inode = _FOUND.unpack_from(body)
    size = 4 if family == socket.AF_INET else 16
    local_port, remote_port = _PORTS.unpack(ports)
    return SocketEntry(state, (local[:size], local_port), (remote[:size], remote_port), user, inode)


def _packed(end: Endpoint) -> tuple[bytes, int]:
    return _plain((ipaddress.ip_address(end[0].partition("%")[0]).packed, end[1]))


def _plain(end: tuple[bytes, int]) -> tuple[bytes, int]:
    address, port = end
    mapped = len(address) == 16 and address.startswith(bytes(10) + b"\xff\xff")
    return (address[12:] if mapped else address), port
