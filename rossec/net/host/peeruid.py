"""Which user is at the other end of a connection within this host.

For a unix socket the kernel says so (SO_PEERCRED); for TCP over loopback its socket table does,
queried for the one connection (`sockdiag`), or read as a whole where that is not available.
A TCP row counts only while it is ESTABLISHED and has an inode: the kernel shows user 0 for sockets
that no process holds any more (TIME_WAIT, closed, not yet accepted), which must not pass for
root's. Users of another user namespace all show as the overflow id, which identifies none: refused.

The user is the creator of the socket. A program that passes its open socket to another one, or a
set-user-id program that connects on behalf of its caller, is responsible for it.
"""

import ipaddress
import socket
import struct
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

from rossec.errors import PeerUserRefused
from rossec.net.host import sockdiag

Endpoint: TypeAlias = tuple[str, int]
"""An IP address and a port."""

TABLES: Final = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))
OVERFLOW: Final = Path("/proc/sys/kernel/overflowuid")
_ESTABLISHED: Final = "01"
_LISTEN: Final = " 0A"
_TRIES: Final = 3  # the kernel returns the table in pieces: a row can be missed between two of them
_HINT: Final = "connect from this host, as the user who runs this program"


class Holder(NamedTuple):
    """The holder of a socket: the user who created it, and the socket's inode."""

    user: int
    inode: int


def holder_in(tables: Iterable[str], local: Endpoint, remote: Endpoint) -> Holder | None:
    """The holder of the socket bound to `local` and connected to `remote`; None: none. Pure.

    `tables` are the texts of /proc/net/tcp and tcp6. An IPv4 address matches in its mapped form
    too (::ffff:127.0.0.1): either side may use a dual-stack socket.
    """
    wanted = {f"{_hex(local, mapped)} {_hex(remote, mapped)} {_ESTABLISHED}" for mapped in (0, 1)}
    found = [holder for row, holder in _rows(tables) if row in wanted]
    return found[0] if len({holder.user for holder in found}) == 1 else None


def listeners_in(tables: Iterable[str], endpoint: Endpoint) -> list[Holder]:
    """The holders of sockets that listen on `endpoint`. Pure."""
    address, port = endpoint
    wanted = {_hex(endpoint, 0), _hex(endpoint, 1), _hex(("::", port), 0)}
    if ":" not in address:
        wanted.add(_hex(("0.0.0.0", port), 0))  # noqa: S104 - looked for
    return [
        holder
        for row, holder in _rows(tables)
        if row.endswith(_LISTEN) and row.partition(" ")[0] in wanted
    ]


def _rows(tables: Iterable[str]) -> Iterator[tuple[str, Holder]]:
    """`local remote state` as the kernel writes it, and the socket's holder, if it has one."""
    for table in tables:
        for line in table.splitlines()[1:]:
            fields = line.split()
            if len(fields) > 9 and fields[9] != "0":
                yield " ".join(fields[1:4]), Holder(int(fields[7]), int(fields[9]))


def tables() -> list[str]:
    """The kernel's tables of TCP sockets, as they are now."""
    return [path.read_text() for path in TABLES if path.exists()]


class UnixPeer(NamedTuple):
    """The other end of a unix socket: the process that connected it or listened, and its user.

    The number of a process that has ended may be given to another one: it identifies nobody.
    """

    process: int
    user: int


def unix_peer(sock: socket.socket) -> UnixPeer:
    """The other end of a connected unix socket (SO_PEERCRED, unix(7)).

    Raises:
        OSError: not connected.
    """
    size = struct.calcsize("3i")
    credentials = sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size)
    process, user, _ = struct.unpack("3i", credentials)
    return UnixPeer(process, user)


def user_of(sock: socket.socket) -> int:
    """The user id at the other end of a connected unix or TCP socket of this host.

    Raises:
        PeerUserRefused: no process holds that end, or it is not on this host.
        OSError: not connected, or the kernel's tables cannot be read.
    """
    if sock.family == socket.AF_UNIX:
        return unix_peer(sock).user
    return holder_of(sock).user


def holder_of(sock: socket.socket) -> Holder:
    """The holder of the other end of a TCP connection within this host.

    Raises:
        PeerUserRefused, OSError: as `user_of`.
    """
    local, remote = sock.getpeername()[:2], sock.getsockname()[:2]
    holder = find_holder(local, remote)
    if holder is not None:
        return holder
    raise PeerUserRefused("the other end of the connection belongs to no program here", _HINT)


def find_holder(local: Endpoint, remote: Endpoint) -> Holder | None:
    """The holder of the socket bound to `local` and connected to `remote`; None: no program.

    Raises:
        OSError: the kernel's tables cannot be read.
    """
    try:
        entry = sockdiag.find(local, remote)
    except OSError:
        for _ in range(_TRIES):
            holder = holder_in(tables(), local, remote)
            if holder is not None:
                return holder
        return None
    return None if entry is None or entry.inode == 0 else Holder(entry.user, entry.inode)


def listeners(endpoint: Endpoint) -> list[Holder]:
    """The holders of sockets that listen on `endpoint`, an address of this host.

    At most one, unless only the tables are available: then all candidates.

    Raises:
        OSError: the kernel's tables cannot be read.
    """
    try:
        entry = sockdiag.listener(endpoint)
    except OSError:
        return listeners_in(tables(), endpoint)
    return [] if entry is None or entry.inode == 0 else [Holder(entry.user, entry.inode)]


def is_known(user: int) -> bool:
    """Whether `user` is not the overflow id, which stands for other user namespaces."""
    return user != int(OVERFLOW.read_text())


def require_user(sock: socket.socket, users: Collection[int]) -> int:
    """Return the user id at the other end.

    Raises:
        PeerUserRefused: not one of `users`, or unknown.
        OSError: as `user_of`.
    """
    user = user_of(sock)
    if user not in users or not is_known(user):
        raise PeerUserRefused(f"user {user} may not use this connection", _HINT)
    return user


def _hex(endpoint: Endpoint, mapped: int) -> str:
    """As the kernel prints it: the address as 32-bit words in the host's byte order."""
    address = ipaddress.ip_address(endpoint[0].partition("%")[0])
    plain = getattr(address, "ipv4_mapped", None) or address
    packed: bytes = plain.packed
    if mapped and len(packed) == 4:
        packed = bytes(10) + b"\xff\xff" + packed
    words = struct.unpack(f"={len(packed) // 4}I", packed)
    return "".join(f"{word:08X}" for word in words) + f":{endpoint[1]:04X}"
