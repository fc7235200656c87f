"""Serving the slave API to one peer, on a loop: a node's own, or a program's behind a sidecar.

The master's calls are parsed before those of others, as a revocation is one; its connection has no
time limit. Another peer has little to say to a node, so it says it in small bodies, and in time.
"""

import asyncio
import contextlib

from ca.certificates import Identity
from rossec.net.aio import SecureStream
from rossec.net.bounds import UNSHOWN_BODY
from rossec.net.rpc.client import serve_calls
from rossec.net.rpc.server import Dispatch
from rossec.participant import slave_api
from rossec.participant.access import Access


async def serve_peer(
    stream: SecureStream[Identity], dispatch: Dispatch[Identity], access: Access
) -> None:
    """Answer the calls of a peer until it closes, or its time is over."""
    if access.is_master(stream.peer):
        stream.raise_unit_limit()
        await serve_calls(stream, dispatch, urgent=True)
        return
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(slave_api.DEADLINE):
            await serve_calls(stream, dispatch, bound=lambda: UNSHOWN_BODY)
