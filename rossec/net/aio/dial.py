"""A TCP connection to a host: whichever of its addresses answers first (RFC 8305)."""

import asyncio
import errno
import socket
from typing import Final

from aiohappyeyeballs import start_connection

STAGGER: Final = 0.25  # seconds; RFC 8305 section 5


async def dial(host: str, port: int, within: float) -> socket.socket:
    """Return a connected, non-blocking socket within that time in seconds.

    Raises:
        TimeoutError: no answer.
        OSError: no address of the host can be reached.
    """
    family = _family(host)
    if family is not None:  # no thread, no resolver, and on loopback no waiting
        sock, connected = _begin(family, (host, port))
        if connected:
            return sock
        async with asyncio.timeout(within):
            return await _complete(sock, (host, port))
    async with asyncio.timeout(within):
        return await _race(host, port)


def _family(host: str) -> int | None:
    """That of a numeric address."""
    for family in (socket.AF_INET, socket.AF_INET6):
        try:
            socket.inet_pton(family, host)
        except OSError:
            continue
        return family
    return None


async def _race(host: str, port: int) -> socket.socket:
    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    found = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    if not found:
        raise OSError(f"no address for {host}")
    cancelled = task is not None and task.cancelling()
    sock = await start_connection(found, happy_eyeballs_delay=STAGGER)
    if task is not None and task.cancelling() > cancelled:  # while other attempts were ended
        sock.close()
        raise asyncio.CancelledError
    return sock


def _begin(family: int, where: tuple[str, int]) -> tuple[socket.socket, bool]:
    """A connecting socket, and whether it is connected already."""
    sock = socket.socket(family, socket.SOCK_STREAM)
    try:
        sock.setblocking(False)
        return sock, sock.connect_ex(where) == errno.EINPROGRESS and _connected(sock)
    except BaseException:
        sock.close()
        raise


async def _complete(sock: socket.socket, where: tuple[str, int]) -> socket.socket:
    try:
        await asyncio.get_running_loop().sock_connect(sock, where)
    except BaseException:
        sock.close()
        raise
    return sock


def _connected(sock: socket.socket) -> bool:
    """On loopback the connection is established when the call returns: no waiting is needed."""
    try:
        sock.getpeername()
    except OSError:
        return False
    return True
