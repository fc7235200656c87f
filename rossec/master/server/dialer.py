"""Connecting to a slave API: the peer must be the node that registered it. A shell.

The only module from which the master connects to nodes. Nothing is sent to any other peer, and a
node that registered the address of another is reported. What is called is up to the caller.
"""

import asyncio
import contextlib
from collections.abc import Callable
from typing import Final

from ca.certificates import Identity
from ca.domains.aliases import shown
from rossec.errors import CallerMismatch, RossecError
from rossec.master.server.updates import CALL_DEADLINE
from rossec.master.state.registry import NodeRef
from rossec.net.aio import SecureContext, WireProtocol, connect
from rossec.net.rpc.client import RpcClient
from rossec.ros.settings import parse_uri


def is_node(peer: Identity, node: NodeRef) -> bool:
    """Whether `peer` is the node that registered: a foreigner is registered under its alias."""
    named = peer.name == node.name if peer.is_foreign else peer.covers(node.name)
    return named and peer.thumbprint == node.thumbprint


class SlaveDialer:
    """Connects as the master; `probed` are the nodes that are being probed.

    Args:
        context: the master's own identity.
        on_mismatch: called with the node and the other peer that answered at its address.
    """

    def __init__(
        self,
        context: SecureContext[Identity],
        on_mismatch: Callable[[NodeRef, Identity], None],
    ) -> None:
        self._context = context
        self._on_mismatch = on_mismatch
        self.probed: Final[set[NodeRef]] = set()

    async def dial(self, node: NodeRef) -> RpcClient:
        """Connect to a slave API; the peer must be the node that registered it.

        Raises:
            CallerMismatch: it is another node.
            RossecError, OSError: the node cannot be reached.
        """
        host, port = parse_uri(node.uri, "the slave API")
        stream = await connect(host, port, self._context, WireProtocol.HTTP)
        if not is_node(stream.peer, node):
            stream.abort("not the node that was registered")
            self._on_mismatch(node, stream.peer)
            other, name = shown(stream.peer.name), shown(node.name)
            raise CallerMismatch(f"{other} answers at the slave API of {name}")
        return RpcClient(stream)

    async def probe(self, node: NodeRef) -> None:
        """Connect to `node` and disconnect: if another peer answers, that is reported."""
        self.probed.add(node)
        try:
            with contextlib.suppress(RossecError, OSError, TimeoutError):
                async with asyncio.timeout(CALL_DEADLINE):
                    await (await self.dial(node)).close()
        finally:
            self.probed.discard(node)
