"""Forwarded ports of a relay ("forwarded_ports"), each of which stands for one target at a peer's site.

A port on loopback admits the programs of allowed users, as a sidecar's port does; one on a network
address admits everybody. There is one for a target, whichever masters want it.
"""

import asyncio
import logging
import socket
from collections.abc import Awaitable, Callable, Iterator, Mapping
from functools import partial
from typing import Final, NamedTuple, TypeAlias

from ca.errors import HintedError
from rossec.errors import LinkCrowded, RelayRefused
from rossec.host.local_ports import LocalPort, Loopback, PortAdmission, PortPool
from rossec.host.runner import TaskSet
from rossec.master.state.forwarded_ports import ForwardedPort, PeerWay, Target
from rossec.overlay.mux import StreamTarget
from rossec.participant import delivery

LIMIT: Final = 4096
_log = logging.getLogger("rossec.overlay")
_HINT: Final = "run a relay for each part of the site"


class PeerTarget(NamedTuple):
    peer: str
    target: StreamTarget


Carry: TypeAlias = Callable[[PeerTarget, socket.socket], Awaitable[None]]
"""Carries one connection until it is over, and owns it. May raise a `HintedError`."""


class OpenPorts:
    """Admits everybody, at this address of the host; `host`: what URIs say, if not that."""

    # They get no further than the handshake of the far node, but can hold up new connections of others.

    def __init__(self, address: str, host: str = "") -> None:
        self.loopback: Final = Loopback(address, host or address)

    async def check(self, sock: socket.socket) -> None:
        """Admitted: who it is, the far node finds out."""


class RelayPorts:
    """All forwarded ports of a relay; `on_given_up`: of one that had to make room for another one."""

    def __init__(
        self,
        admission: PortAdmission,
        carry: Carry,
        on_given_up: Callable[[PeerTarget], None] = lambda _: None,
        limit: int = LIMIT,
    ) -> None:
        self._admission, self._carry, self._on_given_up = admission, carry, on_given_up
        self._tasks = TaskSet()
        self._leaving: set[LocalPort] = set()  # let nobody in any more
        self._ending: set[LocalPort] = set()
        self._pool: PortPool[PeerTarget, LocalPort] = PortPool(self._give_up, limit=limit, hint=_HINT)

    def __iter__(self) -> Iterator[PeerTarget]:
        return iter(self._pool.keys())

    def open(self, forwarded_port: PeerTarget) -> tuple[str, int]:
        def make() -> LocalPort:
            return LocalPort(self._admission, partial(self._attend, forwarded_port))

        port = self._pool.get_or_open(forwarded_port, make)
        port.open()
        return self._admission.loopback.host, port.port

    def close(self, forwarded_port: PeerTarget) -> None:
        port = self._pool.remove(forwarded_port)
        if port is None:
            return
        # Connections that it carries go on: the master wants it no more, their ends still may.
        port.suspend()
        self._leaving.add(port)
        self._close_idle()

    def close_peer(self, peer: str) -> None:
        for forwarded_port in tuple(self):
            if forwarded_port.peer == peer and (port := self._pool.remove(forwarded_port)) is not None:
                self._end(port)

    async def close_all(self) -> None:
        ports = {*self._pool, *self._leaving, *self._ending}
        for forwarded_port in tuple(self):
            self._pool.remove(forwarded_port)
        await asyncio.gather(*(port.close() for port in ports))
        await self._tasks.close()

    async def _attend(self, forwarded_port: PeerTarget, sock: socket.socket) -> None:
        try:
            await self._carry(forwarded_port, sock)
        except HintedError as error:
            crowded = isinstance(error, LinkCrowded)  # one line for all that find no room
            where = "a connection" if crowded else str(forwarded_port.target)
            delivery.warn(_log, delivery.UNREACHED, where, forwarded_port.peer, error)
        finally:
            asyncio.get_running_loop().call_soon(self._close_idle)

    def _close_idle(self) -> None:
        for port in tuple(self._leaving):
            if port.connections == 0:
                self._leaving.remove(port)
                self._end(port)

    def _give_up(self, forwarded_port: PeerTarget, port: LocalPort) -> None:
        self._end(port)
        self._on_given_up(forwarded_port)

    def _end(self, port: LocalPort) -> None:
        port.suspend()
        self._ending.add(port)
        self._tasks.spawn(self._ended(port), f"forwarded port {port.port}")

    async def _ended(self, port: LocalPort) -> None:
        await port.close()
        self._ending.discard(port)


class ForwardedPortTable:
    """Which masters want a forwarded port; `ways`: how each peer is reached, what is not there is no peer."""

    def __init__(
        self,
        admission: PortAdmission,
        carry: Carry,
        ways: Callable[[], Mapping[str, PeerWay]],
        limit: int = LIMIT,
    ) -> None:
        self.ways: Final = ways
        self._ports = RelayPorts(admission, carry, self._given_up, limit)
        self._wanted: dict[Target, set[str]] = {}
        self._dropped: dict[str, set[Target]] = {}  # by master

    def __len__(self) -> int:
        return len(self._wanted)

    async def open(self, target: Target, master: str) -> ForwardedPort:
        if target.peer not in self.ways():
            raise RelayRefused(
                f"no relay is called {target.peer} here", f"rossec relay add {target.peer} FILE"
            )
        host, port = self._ports.open(_forwarded_port(target))
        self._wanted.setdefault(target, set()).add(master)
        return ForwardedPort(host, port)

    def release(self, target: Target, master: str) -> None:
        masters = self._wanted.get(target, set())
        masters.discard(master)
        if not masters and self._wanted.pop(target, None) is not None:
            self._ports.close(_forwarded_port(target))

    def take_dropped(self, master: str) -> set[Target]:
        # What `master` wants and `drop_peer` has closed since the last call.
        # The peer may be back with another descriptor, and masters know the old forwarded ports.
        return self._dropped.pop(master, set())

    async def close(self) -> None:
        await self._ports.close_all()

    def drop_peer(self, peer: str) -> None:
        for target in [each for each in self._wanted if each.peer == peer]:
            for master in self._wanted.pop(target):
                self._dropped.setdefault(master, set()).add(target)
        self._ports.close_peer(peer)

    def _given_up(self, forwarded_port: PeerTarget) -> None:
        self._wanted.pop(Target(forwarded_port.peer, *forwarded_port.target), None)


def _forwarded_port(target: Target) -> PeerTarget:
    return PeerTarget(target.peer, StreamTarget(target.kind, target.name))
