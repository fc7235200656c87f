"""A TCP connection to a host: whichever of its addresses answers first (RFC 8305)."""

import asyncio
import errno
import socket
from typing import Final, TypeAlias

_STAGGER: Final = 0.25  # seconds; RFC 8305 section 5
_Address: TypeAlias = tuple[int, tuple[str, int]]


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
        first, *others = await _addresses(host, port)
        return await (_race([first, *others]) if others else _attempt(*first))


def _family(host: str) -> int | None:
    """That of a numeric address."""
    for family in (socket.AF_INET, socket.AF_INET6):
        try:
            socket.inet_pton(family, host)
        except OSError:
            continue
        return family
    return None


async def _addresses(host: str, port: int) -> list[_Address]:
    found = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)
    if not found:
        raise OSError(f"no address for {host}")
    return [(family, where) for family, _, _, _, where in found]  # type: ignore[misc]  # IPv6 has four


async def _attempt(family: int, where: tuple[str, int]) -> socket.socket:
    sock, connected = _begin(family, where)
    return sock if connected else await _complete(sock, where)


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


async def _race(addresses: list[_Address]) -> socket.socket:
    """Begin with one; add the next after a delay, or at once after a failure."""
    running: set[asyncio.Task[socket.socket]] = set()
    waiting = list(addresses)
    failure = OSError("no address answers")
    try:
        while waiting or running:
            if waiting:
                attempt = _attempt(*waiting.pop(0))
                running.add(asyncio.get_running_loop().create_task(attempt))
            stagger = _STAGGER if waiting else None
            done, _ = await asyncio.wait(
                running, timeout=stagger, return_when=asyncio.FIRST_COMPLETED
            )
            for task in done:
                running.discard(task)
                error = task.exception()
                if error is None:
                    return task.result()
                failure = error if isinstance(error, OSError) else failure
        raise failure
    finally:
        _abandon(running)


def _abandon(tasks: set[asyncio.Task[socket.socket]]) -> None:
    """Cancel without waiting: a caller cancelled just then would leak the connected socket."""
    for task in tasks:
        task.add_done_callback(_drop)
        task.cancel()


def _drop(task: asyncio.Task[socket.socket]) -> None:
    if not task.cancelled() and task.exception() is None:
        task.result().close()
