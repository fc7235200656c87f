"""Forwarded ports of a relay ("forwarded_ports"), each of which stands for one target at a peer's site.

A port on loopback admits the programs of allowed users, as a sidecar's port does; one on a network
address admits everybody. There is one for a target, whichever masters want it.
"""

import asyncio
import logging
import socket
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import Final, TypeAlias

from ca.errors import HintedError
from rossec.errors import LinkCrowded, RelayRefused
from rossec.host.local_ports import LocalPort, Loopback, PortAdmission, PortPool
from rossec.host.runner import TaskSet
from rossec.master.state.forwarded_ports import ForwardedPort, PeerWay, Target
from rossec.participant import delivery_options

LIMIT: Final = 4096
_log = logging.getLogger("rossec.overlay")
_HINT: Final = "run a relay for each part of the site"


Carry: TypeAlias = Callable[[Target, socket.socket], Awaitable[None]]
"""Carries one connection until it is over, and owns it. May raise a `HintedError`."""


class OpenPorts:
    """Admits everybody, at this address of the host; `host`: what URIs say, if not that."""

    # They get no further than the handshake of the far node, but can hold up new connections of others.

    def __init__(self, address: str, host: str = "") -> None:
        self.loopback: Final = Loopback(address, host or address)

    async def check(self, sock: socket.socket) -> None:
        """Admitted: who it is, the far node finds out."""


class ForwardedPortTable:
    """All forwarded ports of a relay, and which masters want each.

    `ways`: how each peer is reached; what is not there is no peer.
    """

    def __init__(
        self,
        admission: PortAdmission,
        carry: Carry,
        ways: Callable[[], Mapping[str, PeerWay]],
        limit: int = LIMIT,
    ) -> None:
        self._admission, self._carry, self.ways = admission, carry, ways
        self.wanted: dict[Target, set[str]] = {}
        self._dropped: dict[str, set[Target]] = {}  # by master
        self._tasks = TaskSet()
        self._leaving: set[LocalPort] = set()  # let nobody in any more
        self._ending: set[LocalPort] = set()
        self._pool: PortPool[Target, LocalPort] = PortPool(self._give_up, limit=limit, hint=_HINT)

    async def open(self, target: Target, master: str) -> ForwardedPort:
        if target.peer not in self.ways():
            raise RelayRefused(
                f"no relay is called {target.peer} here", f"rossec relay add {target.peer} FILE"
            )
        port = self._pool.get_or_open(
            target, lambda: LocalPort(self._admission, partial(self._attend, target))
        )
        port.open()
        self.wanted.setdefault(target, set()).add(master)
        return ForwardedPort(self._admission.loopback.host, port.port)

    def release(self, target: Target, master: str) -> None:
        masters = self.wanted.get(target, set())
        masters.discard(master)
        if masters or self.wanted.pop(target, None) is None:
            return
        port = self._pool.remove(target)
        if port is not None:
            # Connections that it carries go on: the master wants it no more, their ends still may.
            port.suspend()
            self._leaving.add(port)
            self._close_idle()

    def take_dropped(self, master: str) -> set[Target]:
        # What `master` wants and `drop_peer` has closed since the last call.
        # The peer may be back with another descriptor, and masters know the old forwarded ports.
        return self._dropped.pop(master, set())

    def drop_peer(self, peer: str) -> None:
        for target in [each for each in self.wanted if each.peer == peer]:
            for master in self.wanted.pop(target):
                self._dropped.setdefault(master, set()).add(target)
        for target in self._pool.keys():  # noqa: SIM118 - no dict: its keys are a copy - a pool iterates over its ports
            if target.peer == peer and (port := self._pool.remove(target)) is not None:
                self._end(port)

    async def close(self) -> None:
        ports = {*self._pool, *self._leaving, *self._ending}
        for target in self._pool.keys():  # noqa: SIM118 - no dict: its keys are a copy
            self._pool.remove(target)
        await asyncio.gather(*(port.close() for port in ports))
        await self._tasks.close()

    async def _attend(self, target: Target, sock: socket.socket) -> None:
        try:
            await self._carry(target, sock)
        except HintedError as error:
            crowded = isinstance(error, LinkCrowded)  # one line for all that find no room
            where = "a connection" if crowded else f"{target.kind} {target.name}"
            delivery_options.warn(_log, delivery_options.UNREACHED, where, target.peer, error)
        finally:
            asyncio.get_running_loop().call_soon(self._close_idle)

    def _close_idle(self) -> None:
        for port in tuple(self._leaving):
            if port.connections == 0:
                self._leaving.remove(port)
                self._end(port)

    def _give_up(self, target: Target, port: LocalPort) -> None:
        self._end(port)
        self.wanted.pop(target, None)

    def _end(self, port: LocalPort) -> None:
        port.suspend()
        self._ending.add(port)
        self._tasks.spawn(self._ended(port), f"forwarded port {port.port}")

    async def _ended(self, port: LocalPort) -> None:
        await port.close()
        self._ending.discard(port)
