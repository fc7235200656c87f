"""Peers of before, which know XML-RPC alone, beside those with the compact form, in each mix.

A peer of before is made of one of today by taking its offers, or its answers to offers, away: what
it sends then is what peers of before sent. Registration, a topic, pushes of parameters, of
publishers and of a revocation, and parameters of every type must work in each mix.
"""

import asyncio
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from grants.model import Right
from rossec.master.server.updates import SlaveDialer
from rossec.master.state.registry import NodeRef
from rossec.net.rpc.calls import RpcClient
from rossec.participant.membership import MasterSession
from rossec.ros.calls import CallClient, CallServer
from tests.support.site import Site
from tests.support.witness import undisturbed, until

VALUE = {
    "i": [0, -1, 2**31 - 1, -(2**31)],
    "d": [0.5, 1.0, -0.0, 1e300],
    "b": [True, False],
    "s": ["", "é\t\n", "x" * 300],
    "raw": bytes(range(256)),
    "deep": {"er": [[{}], []]},
    "when": datetime.fromisoformat("2026-11-23T09:08:07"),
}
PARAMS = Right.PARAM_GET | Right.PARAM_SET


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """How many requests were made in each form."""
    found = {"xml": 0, "units": 0}
    request = CallClient.request

    def count(self: CallClient, method: str, params: Any) -> bytes:
        found["units" if self.is_compact else "xml"] += 1
        return request(self, method, params)

    monkeypatch.setattr(CallClient, "request", count)
    return found


def without_offers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Callers of before."""
    init = CallClient.__init__
    monkeypatch.setattr(
        CallClient,
        "__init__",
        lambda self, host, **options: init(self, host, **{**options, "compact": False}),
    )


def without_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Responders of before."""
    init = CallServer.__init__
    monkeypatch.setattr(
        CallServer, "__init__", lambda self, **options: init(self, **{**options, "compact": False})
    )


def nothing(_: pytest.MonkeyPatch) -> None:
    """All of today."""


@pytest.mark.parametrize("old", [nothing, without_offers, without_answers])
async def test_everything_works_in_each_mix(
    old: Callable[[pytest.MonkeyPatch], None],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    counted: dict[str, int],
) -> None:
    old(monkeypatch)
    async with Site(tmp_path / "site").running() as site:
        for name in ("/robot", "/viewer"):
            site.grant(name, PARAMS, "/robot/set")
        async with undisturbed(site) as witness:
            robot, viewer = witness.robot, witness.viewer
            seen = await viewer.params.subscribe("/robot/set")
            await robot.params.set("/robot/set", VALUE)
            await until(lambda: seen.value == VALUE)
            assert await viewer.params.get("/robot/set") == VALUE
            await asyncio.gather(*(robot.params.set("/robot/set/i", n) for n in range(30)))
            await until(lambda: seen.updates > 2)
            await witness.goes_on()
        assert (counted["units"] > 20) == (old is nothing)
        assert counted["xml"] > 4


async def test_own_nodes_and_masters_use_units_among_themselves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A session with the master, and what the master pushes."""
    dialed: list[RpcClient] = []
    dial = SlaveDialer.dial

    async def remember(self: SlaveDialer, node: NodeRef) -> RpcClient:
        dialed.append(await dial(self, node))
        return dialed[-1]

    monkeypatch.setattr(SlaveDialer, "dial", remember)
    async with Site(tmp_path / "site").running() as site, undisturbed(site) as witness:
        for node in (witness.robot, witness.viewer):
            session: MasterSession = node._membership.session
            assert session._client is not None
            assert session._client.is_compact
        await until(lambda: any(client.is_compact for client in dialed))
