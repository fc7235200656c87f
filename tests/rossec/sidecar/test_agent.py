"""One identity: what ends its conversations, and how many doors it opens."""

import time

import pytest

from rossec.channel.opening import WireProtocol
from rossec.clock import Clock
from rossec.errors import RossecError
from rossec.sidecar.core.endpoints import Endpoint, local_endpoint
from tests.rossec.sidecar.program import string_message
from tests.rossec.sidecar.sidecar_pair import SidecarPair, connect, receive_bytes, wait_closed


async def test_revocation_cuts_the_conversation(pair: SidecarPair) -> None:
    stream, source = await connect(pair)
    data = pair.site.revoke(pair.site.identity("/listener").thumbprint)
    assert pair.site.master is not None
    await pair.talker.ask(pair.talker.master_uri, "getPid")
    agent = pair.talker_sidecar._agent_for("/talker")
    await agent._membership._session.call("rossec.updateRevocations", data)
    await wait_closed(stream)
    await wait_closed(source)


async def test_an_expired_grant_cuts_the_conversation(
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


async def test_without_news_of_revocations_the_conversation_is_cut(
    pair: SidecarPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream, source = await connect(pair)
    monkeypatch.setattr("rossec.clock.HOST", Clock(lambda: time.time() + 200))
    await wait_closed(stream)
    await wait_closed(source)


async def test_an_identity_that_nobody_watches_over_serves_nobody(
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


async def test_old_doors_make_room(pair: SidecarPair, monkeypatch: pytest.MonkeyPatch) -> None:
    stream, source = await connect(pair)
    for name in ("/talker", "/listener"):
        agent = (pair.talker_sidecar if name == "/talker" else pair.listener_sidecar)._agent_for(
            name
        )
        for table in (agent._ingress.ports, agent._egress.ports):
            monkeypatch.setattr(table, "_limit", 4)
        far = [Endpoint(WireProtocol.TCPROS, "127.0.0.9", port) for port in range(1, 9)]
        ports = [
            agent.state.endpoints.add_egress(place, agent.open_egress(place)).port for place in far
        ]
        assert (
            agent.state.endpoints.peer_at(local_endpoint(WireProtocol.TCPROS, ports[-1])) == far[-1]
        )
        assert agent.state.endpoints.peer_at(local_endpoint(WireProtocol.TCPROS, ports[0])) is None
        for port in range(1, 9):
            agent.open_ingress(local_endpoint(WireProtocol.HTTP, port))
        assert len(list(agent._ingress.ports)) == len(list(agent._egress.ports)) == 4
    await source.send(string_message("still"))
    assert await receive_bytes(stream, len(string_message("still"))) == string_message("still")
