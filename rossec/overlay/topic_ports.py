"""The TCPROS ports of nodes of the own domain: the relay asks each node, and checks who answers.

An address that a node registered may be anybody's. So a relay brings callers to it only after a
handshake of its own: the node there has the name that is registered. Which caller it admits is
that node's decision.
"""

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

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


@dataclass(slots=True)
class _Known:
    """What one node said; `turn`: it is asked by one caller at a time."""

    turn: asyncio.Lock = field(default_factory=asyncio.Lock)
    port: int = 0
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

    async def of(self, name: str, host: str, port: int) -> int:
        """The TCPROS port of the node `name`, whose slave API is at this address.

        Raises:
            HintedError: it is not there, is another node, revoked, or does not tell.
        """
        key = name, host, port
        known = self._nodes.get(key)
        if known is None:
            if len(self._nodes) >= MOST:
                del self._nodes[next(iter(self._nodes))]
            known = self._nodes[key] = _Known()
        async with known.turn:
            if known.until < time.monotonic():
                known.port = await self._ask(name, host, port)
                known.until = time.monotonic() + KEPT_SECONDS
            return known.port

    def forget(self, name: str, host: str, port: int) -> None:
        """Ask again next time: nobody was at the port."""
        self._nodes.pop((name, host, port), None)

    async def _ask(self, name: str, host: str, port: int) -> int:
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
                return found
            case _:
                raise RelayRefused(f"{shown(name)} does not say where its topics are")

    def _check(self, stream: SecureStream[Identity], name: str) -> None:
        peer = stream.peer
        if peer.is_foreign or not peer.covers(name):
            raise RelayRefused(
                f"{shown(peer.name)} answers at the address that {shown(name)} registered"
            )
        self._check_peer(peer, clock.now())
