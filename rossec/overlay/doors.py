"""Doors: local ports of the relay, each of which stands for one target at a peer's site.

A door on loopback admits the programs of allowed users, as a sidecar's port does; one on a network
address admits everybody, who gets no further than the handshake of the far node, but can hold up
new connections of others. The pool is bounded, and the least recently requested door without
connections is given up for a new one.
"""

import asyncio
import logging
import socket
from collections.abc import Awaitable, Callable, Iterator
from functools import partial
from typing import Final, NamedTuple, TypeAlias

from ca.errors import HintedError
from rossec.errors import LinkCrowded
from rossec.net import withheld_log
from rossec.net.aio.tasks import TaskSet
from rossec.overlay.mux_units import Target
from rossec.sidecar.core.endpoints import Loopback
from rossec.sidecar.loopback_port import Admission, LocalPort
from rossec.sidecar.port_pool import PortPool

LIMIT: Final = 4096
_log = logging.getLogger("rossec.overlay")
_HINT: Final = "run a relay for each part of the site"


class Door(NamedTuple):
    """What a door stands for: a target at the site of a peer, which has this label here."""

    peer: str
    target: Target


Carry: TypeAlias = Callable[[Door, socket.socket], Awaitable[None]]
"""Carries one connection until it is over, and owns it. May raise a `HintedError`."""


class OpenDoors:
    """Admits everybody, at this address of the host; `host`: what URIs say, if not that."""

    def __init__(self, address: str, host: str = "") -> None:
        self.loopback: Final = Loopback(address, host or address)

    async def check(self, sock: socket.socket) -> None:
        """Admitted: who it is, the far node finds out."""


class Doors:
    """All doors of a relay.

    Args:
        admission: where doors are, and who may use them: `Callers` or `OpenDoors`.
        carry: what happens to a connection.
        on_given_up: called with a door that had to make room for another one.
    """

    def __init__(
        self,
        admission: Admission,
        carry: Carry,
        on_given_up: Callable[[Door], None] = lambda _: None,
        limit: int = LIMIT,
    ) -> None:
        self._admission = admission
        self._carry = carry
        self._on_given_up = on_given_up
        self._tasks = TaskSet()
        self._leaving: set[LocalPort] = set()  # let nobody in any more
        self._ending: set[LocalPort] = set()
        self._pool: PortPool[Door, LocalPort] = PortPool(self._give_up, limit=limit, hint=_HINT)

    def __iter__(self) -> Iterator[Door]:
        return iter(self._pool.keys())

    def open(self, door: Door) -> tuple[str, int]:
        """Host and port of the door; it listens.

        Raises:
            ConfigurationError: all doors are in use.
            OSError: the host has no free port or descriptor.
        """
        port = self._pool.get_or_open(door, partial(self._make, door))
        port.open()
        return self._admission.loopback.host, port.port

    def close(self, door: Door) -> None:
        """Admit nobody more; connections that are open go on."""
        port = self._pool.remove(door)
        if port is None:
            return
        port.suspend()
        self._leaving.add(port)
        self._close_idle()

    def close_peer(self, peer: str) -> None:
        """Close every door to the peer with this label, and its connections."""
        for door in tuple(self):
            if door.peer == peer:
                port = self._pool.remove(door)
                if port is not None:
                    self._end(port)

    async def close_all(self) -> None:
        """Close every door and every connection."""
        ports = {*self._pool, *self._leaving, *self._ending}
        for door in tuple(self):
            self._pool.remove(door)
        await asyncio.gather(*(port.close() for port in ports))
        await self._tasks.close()

    def _make(self, door: Door) -> LocalPort:
        return LocalPort(self._admission, partial(self._attend, door))

    async def _attend(self, door: Door, sock: socket.socket) -> None:
        try:
            await self._carry(door, sock)
        except HintedError as error:
            crowded = isinstance(error, LinkCrowded)  # one line for all that find no room
            where = "a connection" if crowded else str(door.target)
            withheld_log.warn(_log, withheld_log.UNREACHED, where, door.peer, error)
        finally:
            asyncio.get_running_loop().call_soon(self._close_idle)

    def _close_idle(self) -> None:
        """Close the ports that wait for their last connection, which is over now."""
        for port in tuple(self._leaving):
            if port.connections == 0:
                self._leaving.remove(port)
                self._end(port)

    def _give_up(self, door: Door, port: LocalPort) -> None:
        self._end(port)
        self._on_given_up(door)

    def _end(self, port: LocalPort) -> None:
        port.suspend()
        self._ending.add(port)
        self._tasks.spawn(self._ended(port), f"door {port.port}")

    async def _ended(self, port: LocalPort) -> None:
        await port.close()
        self._ending.discard(port)
