"""One identity: what ends its conversations, and how many doors it opens."""

import time

import pytest

from rossec.channel.opening import WireProtocol
from rossec.clock import Clock
from rossec.errors import RossecError
from rossec.sidecar.core.endpoints import Endpoint, inside
from tests.rossec.sidecar.conversation import Pair, connect, ends, heard
from tests.rossec.sidecar.program import word


async def test_revocation_cuts_the_conversation(pair: Pair) -> None:
    stream, source = await connect(pair)
    data = pair.site.revoke(pair.site.identity("/listener").thumbprint)
    assert pair.site.master is not None
    await pair.talker.ask(pair.talker.master_uri, "getPid")
    agent = pair.near._agent_for("/talker")
    await agent._membership._session.call("rossec.updateRevocations", data)
    await ends(stream)
    await ends(source)


async def test_an_expired_grant_cuts_the_conversation(
    pair: Pair, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    for file in pair.site.enroll("/listener").path.glob("grants/*"):
        file.unlink()
    pair.site.subscribe("/listener", "/word", lifetime=60)
    stream, source = await connect(pair)
    monkeypatch.setattr("rossec.clock.HOST", Clock(lambda: time.time() + 60))
    await ends(stream)
    assert "cut /listener: its grant or its certificate has expired" in caplog.text
    await ends(source)


async def test_without_news_of_revocations_the_conversation_is_cut(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream, source = await connect(pair)
    monkeypatch.setattr("rossec.clock.HOST", Clock(lambda: time.time() + 200))
    await ends(stream)
    await ends(source)


async def test_an_identity_that_nobody_watches_over_serves_nobody(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream, source = await connect(pair)
    agent = pair.near._agent_for("/talker")

    def crash(_: int) -> None:
        raise ArithmeticError

    monkeypatch.setattr(agent._watch, "close_terminated", crash)
    await ends(stream)
    await ends(source)
    with pytest.raises(RossecError):
        await pair.talker.ask(pair.talker.master_uri, "getPid")


async def test_old_doors_make_room(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    stream, source = await connect(pair)
    for name in ("/talker", "/listener"):
        agent = (pair.near if name == "/talker" else pair.far)._agent_for(name)
        for table in (agent._exports.doorways, agent._imports.doorways):
            monkeypatch.setattr(table, "_limit", 4)
        far = [Endpoint(WireProtocol.TCPROS, "127.0.0.9", port) for port in range(1, 9)]
        ports = [agent.tenant.doors.opened_inside(place, agent.bring(place)).port for place in far]
        assert agent.tenant.doors.peer_behind(inside(WireProtocol.TCPROS, ports[-1])) == far[-1]
        assert agent.tenant.doors.peer_behind(inside(WireProtocol.TCPROS, ports[0])) is None
        for port in range(1, 9):
            agent.export(inside(WireProtocol.HTTP, port))
        assert len(list(agent._exports.doorways)) == len(list(agent._imports.doorways)) == 4
    await source.send(word("still"))
    assert await heard(stream, len(word("still"))) == word("still")
