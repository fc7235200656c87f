"""One identity: what closes its connections, and how many ports it opens."""

import time

import pytest

from rossec.channel.opening import WireProtocol
from rossec.clock import Clock
from rossec.errors import RossecError
from rossec.sidecar.core.endpoints import Endpoint, local_endpoint
from tests.rossec.sidecar.program import string_message
from tests.rossec.sidecar.sidecar_pair import SidecarPair, connect, receive_bytes, wait_closed


async def test_revocation_closes_the_connection(pair: SidecarPair) -> None:
    stream, source = await connect(pair)
    data = pair.site.revoke(pair.site.identity("/listener").thumbprint)
    assert pair.site.master is not None
    await pair.talker.ask(pair.talker.master_uri, "getPid")
    agent = pair.talker_sidecar._agent_for("/talker")
    await agent._membership._session.call("rossec.updateRevocations", data)
    await wait_closed(stream)
    await wait_closed(source)


async def test_an_expired_grant_closes_the_connection(
    pair: SidecarPair, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    for file in pair.site.enroll("/listener").path.glob("grants/*"):
        file.unlink()
    pair.site.subscribe("/listener", "/word", lifetime=60)
    stream, source = await connect(pair)
    monkeypatch.setattr("rossec.clock.HOST", Clock(lambda: time.time() + 60))
    await wait_closed(stream)
    assert "cut /listener: its grant or its certificate has expired" in caplog.text
    await wait_closed(source)


async def test_stale_revocation_data_closes_the_connection(
    pair: SidecarPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream, source = await connect(pair)
    monkeypatch.setattr("rossec.clock.HOST", Clock(lambda: time.time() + 200))
    await wait_closed(stream)
    await wait_closed(source)


async def test_an_agent_without_watchdog_closes_everything(
    pair: SidecarPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream, source = await connect(pair)
    agent = pair.talker_sidecar._agent_for("/talker")

    def crash(_: int) -> None:
        raise ArithmeticError

    monkeypatch.setattr(agent._watchdog, "close_terminated", crash)
    await wait_closed(stream)
    await wait_closed(source)
    with pytest.raises(RossecError):
        await pair.talker.ask(pair.talker.master_uri, "getPid")


async def test_old_ports_are_evicted(pair: SidecarPair, monkeypatch: pytest.MonkeyPatch) -> None:
    stream, source = await connect(pair)
    for name in ("/talker", "/listener"):
        agent = (pair.talker_sidecar if name == "/talker" else pair.listener_sidecar)._agent_for(
            name
        )
        for pool in (agent._ingress.ports, agent._egress.ports):
            monkeypatch.setattr(pool, "_limit", 4)
        remotes = [Endpoint(WireProtocol.TCPROS, "127.0.0.9", port) for port in range(1, 9)]
        ports = [
            agent.state.endpoints.add_egress(remote, agent.open_egress(remote)).port
            for remote in remotes
        ]
        assert (
            agent.state.endpoints.peer_at(local_endpoint(WireProtocol.TCPROS, ports[-1]))
            == remotes[-1]
        )
        assert agent.state.endpoints.peer_at(local_endpoint(WireProtocol.TCPROS, ports[0])) is None
        for port in range(1, 9):
            agent.open_ingress(local_endpoint(WireProtocol.HTTP, port))
        assert len(list(agent._ingress.ports)) == len(list(agent._egress.ports)) == 4
    await source.send(string_message("still"))
    assert await receive_bytes(stream, len(string_message("still"))) == string_message("still")
