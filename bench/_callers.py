"""What a call costs its caller: the same calls by our own client, in both forms, in turn."""

import asyncio
import time
from collections.abc import Mapping
from statistics import median

from bench._lines import Call
from bench._masters import EnrolledNode, Master
from ca.certificates import TrustAnchor
from rossec.net.aio import SecureContext, WireProtocol, connect
from rossec.net.rpc import RpcClient

_BLOCKS, _EACH = 9, 60


async def _block(client: RpcClient, call: Call, each: int) -> float:
    """Seconds of this process's processor time for one call."""
    method, *params = call
    begin = time.process_time()
    for _ in range(each):
        await client.call(method, *params)
    return (time.process_time() - begin) / each


async def _ratios(
    master: Master, member: EnrolledNode, anchor: TrustAnchor, calls: Mapping[str, Call], nodes: int
) -> dict[str, float]:
    own = SecureContext(member.credentials, anchor.verify)
    clients = [
        RpcClient(await connect("127.0.0.1", master.port, own, WireProtocol.HTTP), compact=compact)
        for compact in (True, False)
    ]
    for client in clients:
        await client.call("rossec.presentGrants", member.name, [member.grant])
    found = {}
    for name, call in calls.items():
        each = max(2, _EACH // nodes) if call[0] == "getSystemState" else _EACH
        pairs = [[await _block(client, call, each) for client in clients] for _ in range(_BLOCKS)]
        found[name] = round(median(compact / xml for compact, xml in pairs), 2)
    for client in clients:
        await client.close()
    return found


def caller_cpu(
    master: Master, member: EnrolledNode, anchor: TrustAnchor, calls: Mapping[str, Call], nodes: int
) -> dict[str, float]:
    """By operation: processor time of a caller in the compact form through that in XML-RPC.

    `nodes`: how many are registered; who lists the graph has so much to read.
    """
    return asyncio.run(_ratios(master, member, anchor, calls, nodes))
