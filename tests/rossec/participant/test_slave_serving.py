"""Serving the slave API: the master's calls may be long, and have no end."""

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest

from rossec.net.limits import UNSHOWN_BODY
from rossec.net.rpc.calls import RpcClient
from rossec.participant import slave_api
from rossec.participant.connections import serve_peer
from rossec.ros.xmlrpc import Fault
from tests.support.streams import stream_pair


class Serving:
    """One peer of a node that knows `/master` as its master."""

    def __init__(self, peer: str) -> None:
        near, far = stream_pair(peer, "/node")
        self.raised = 0
        stream = cast("Any", far)
        stream.raise_unit_limit = self._raise
        access = cast("Any", SimpleNamespace(is_master=lambda other: other == "/master"))
        self.client = RpcClient(near)
        self.task = asyncio.ensure_future(serve_peer(stream, self.dispatch, access))

    def _raise(self) -> None:
        self.raised += 1

    def dispatch(self, method: str, params: tuple[object, ...], _: object) -> object:
        return [1, method, len(str(params))]


async def test_the_masters_calls_may_be_long() -> None:
    served = Serving("/master")
    assert await served.client.ask("paramUpdate", "x" * 2 * UNSHOWN_BODY) > UNSHOWN_BODY  # type: ignore[operator]
    assert served.raised == 1
    await served.client.close()
    await served.task


async def test_those_of_others_are_short() -> None:
    served = Serving("/eve")
    with pytest.raises(Fault, match="has shown no grant"):
        await served.client.ask("getPid", "x" * 2 * UNSHOWN_BODY)
    assert await served.client.ask("getPid", "x") == len("('x',)")
    assert not served.raised
    await served.client.close()
    await served.task


async def test_another_peer_is_disconnected_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slave_api, "DEADLINE", 0.05)
    served, master = Serving("/eve"), Serving("/master")
    await served.task
    assert not master.task.done()
    await master.client.close()
    await master.task
