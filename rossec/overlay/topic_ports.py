"""Where nodes of the own domain are: the relay calls at each place, and checks who answers.

An address that a node registered may be anybody's. So a relay brings callers to it only after a
handshake of its own, and to the numeric address where that was: a name may be resolved to another
one the next time. A node there has the name that is registered; at a service's address it is some
node of the domain, as callers check which one. Whom it admits is that node's decision.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Final, TypeAlias

from ca.certificates import Identity
from ca.domains.aliases import shown
from rossec import clock
from rossec.errors import RelayRefused
from rossec.net.aio import SecureContext, SecureStream, WireProtocol, connect
from rossec.net.rpc.client import RpcClient
from rossec.ros.names import PORTS
from rossec.ros.xmlrpc import Fault

KEPT_SECONDS: Final = 30.0
MOST: Final = 4096
_SERVICE: Final = ""  # as a node's name: of whichever node it is
Place: TypeAlias = tuple[str, int]
"""Numeric address and port."""


@dataclass(slots=True)
class _Known:
    """Where one node is; `turn`: it is asked by one caller at a time."""

    turn: asyncio.Lock = field(default_factory=asyncio.Lock)
    place: Place = "", 0
    until: float = 0.0


class TopicPorts:
    """Asks as the relay `name`; each answer is kept for `KEPT_SECONDS`.

    Args:
        check_peer: as `Access.check_peer`.
    """

    def __init__(
        self,
        context: SecureContext[Identity],
        name: str,
        check_peer: Callable[[Identity, int], None],
    ) -> None:
        self._context = context
        self._name = name
        self._check_peer = check_peer
        self._nodes: dict[tuple[str, str, int], _Known] = {}  # the oldest first

    async def of(self, name: str, host: str, port: int) -> Place:
        """Where the node `name`, whose slave API is at this address, has its topics.

        Raises:
            HintedError: it is not there, is another node, revoked, or does not tell.
        """
        return await self._kept(name, host, port, partial(self._ask, name))

    async def provider(self, host: str, port: int) -> Place:
        """Where a service is whose address is this one: a node of the own domain is there.

        Raises:
            HintedError: none is, or it is revoked.
        """
        return await self._kept(_SERVICE, host, port, self._call_at)

    def forget(self, name: str, host: str, port: int) -> None:
        """Ask again next time: nobody was at the port."""
        for each in (name, _SERVICE):
            self._nodes.pop((each, host, port), None)

    async def _kept(
        self, name: str, host: str, port: int, find: Callable[[str, int], Awaitable[Place]]
    ) -> Place:
        key = name, host, port
        known = self._nodes.get(key)
        if known is None:
            if len(self._nodes) >= MOST:
                del self._nodes[next(iter(self._nodes))]
            known = self._nodes[key] = _Known()
        async with known.turn:
            if known.until < time.monotonic():
                known.place = await find(host, port)
                known.until = time.monotonic() + KEPT_SECONDS
            return known.place

    async def _call_at(self, host: str, port: int) -> Place:
        stream = await connect(host, port, self._context, WireProtocol.TCPROS)
        try:
            if stream.peer.is_foreign:
                raise RelayRefused(f"{shown(stream.peer.name)} answers at a service's address")
            self._check_peer(stream.peer, clock.now())
            return stream.address, port
        finally:
            await stream.close()

    async def _ask(self, name: str, host: str, port: int) -> Place:
        stream = await connect(host, port, self._context, WireProtocol.HTTP)
        try:
            self._check(stream, name)
            answer = await RpcClient(stream).ask(PORTS, self._name)
        except Fault as fault:
            raise RelayRefused(
                f"{shown(name)} is older than this relay: {fault.faultString}", "update its rossec"
            ) from fault
        finally:
            await stream.close()
        match answer:
            case [int() as found] if 0 < found < 1 << 16 and not isinstance(found, bool):
                return stream.address, found
            case _:
                raise RelayRefused(f"{shown(name)} does not say where its topics are")

    def _check(self, stream: SecureStream[Identity], name: str) -> None:
        peer = stream.peer
        if peer.is_foreign or not peer.covers(name):
            raise RelayRefused(
                f"{shown(peer.name)} answers at the address that {shown(name)} registered"
            )
        self._check_peer(peer, clock.now())
