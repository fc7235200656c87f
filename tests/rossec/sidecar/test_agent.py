"""One identity: what closes its connections, its session with the master, and its ports."""

import logging
import time
from pathlib import Path

import pytest

from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.clock import Clock
from rossec.errors import HangUp, RossecError
from rossec.sidecar.core.layers import ListeningAddress, local_endpoint
from tests.rossec.sidecar.program import Program, sidecar, string_message
from tests.rossec.sidecar.sidecar_pair import SidecarPair, connect, receive_bytes, wait_closed
from tests.support.site import Site
from tests.support.witness import until


async def test_revocation_closes_the_connection(pair: SidecarPair) -> None:
    stream, source = await connect(pair)
    data = pair.site.revoke(pair.site.identity("/listener").thumbprint)
    assert pair.site.master is not None
    await pair.talker.ask(pair.talker.master_uri, "getPid")
    agent = pair.talker_sidecar._agent_for("/talker")
    await agent._membership.session.call("rossec.updateRevocations", data)
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
    assert "closed the connection with /listener (/word): its grant or its certificate" in caplog.text
    await wait_closed(source)


async def test_stale_revocation_data_closes_the_connection(
    pair: SidecarPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream, source = await connect(pair)
    monkeypatch.setattr("rossec.clock.HOST", Clock(lambda: time.time() + 200))
    await wait_closed(stream)
    await wait_closed(source)


@pytest.mark.parametrize("part", ["watchdog", "maintenance", "resubscriber"])
async def test_an_agent_whose_task_crashes_closes_everything(
    pair: SidecarPair, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    stream, source = await connect(pair)
    agent = pair.talker_sidecar._agent_for("/talker")

    def crash(*_: object) -> None:
        raise ArithmeticError

    owner, name = {
        "watchdog": (agent._connections, "cut_ended"),
        "maintenance": (agent, "maintain"),
        "resubscriber": (agent._resubscriber._to_resubscribe, "take_due"),
    }[part]
    monkeypatch.setattr(owner, name, crash)
    await wait_closed(stream)
    await wait_closed(source)
    with pytest.raises(RossecError):
        await pair.talker.ask(pair.talker.master_uri, "getPid")


async def test_old_ports_are_evicted(pair: SidecarPair, monkeypatch: pytest.MonkeyPatch) -> None:
    stream, source = await connect(pair)
    for name in ("/talker", "/listener"):
        agent = (pair.talker_sidecar if name == "/talker" else pair.listener_sidecar)._agent_for(name)
        for pool in (agent._ingress.ports, agent._egress.ports):
            monkeypatch.setattr(pool, "_limit", 4)
        remotes = [ListeningAddress(WireProtocol.TCPROS, "127.0.0.9", port) for port in range(1, 9)]
        ports = [
            agent.state.endpoints.add_egress(remote, agent.open_egress(remote)).port for remote in remotes
        ]
        assert agent.state.endpoints.peer_at(local_endpoint(WireProtocol.TCPROS, ports[-1])) == remotes[-1]
        assert agent.state.endpoints.peer_at(local_endpoint(WireProtocol.TCPROS, ports[0])) is None
        for port in range(1, 9):
            agent.open_ingress(local_endpoint(WireProtocol.HTTP, port))
        assert len(list(agent._ingress.ports)) == len(list(agent._egress.ports)) == 4
    await source.send(string_message("still"))
    assert await receive_bytes(stream, len(string_message("still"))) == string_message("still")


async def test_programs_are_registered_again_with_a_restarted_master(pair: SidecarPair) -> None:
    stream, source = await connect(pair)
    await pair.site.restart_master()
    update = "publisherUpdate"
    await until(lambda: any(method == update for method, _ in pair.listener.calls), within=30)
    await source.send(string_message("still"))
    assert await receive_bytes(stream, len(string_message("still"))) == string_message("still")


async def test_a_call_fails_without_a_master(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    site.enroll("/talker")
    async with site.running(), sidecar(site) as running:
        assert site.master is not None
        await site.master.close()
        async with Program("/talker", running) as talker:
            with pytest.raises(RossecError):
                await talker.ask(talker.master_uri, "getPid")


async def test_a_revoked_master_is_not_called(pair: SidecarPair) -> None:
    """Nothing is sent to it, not even while revocation data is stale."""
    await connect(pair)
    data = pair.site.revoke(pair.site.identity("/master").thumbprint)
    agent = pair.talker_sidecar._agent_for("/talker")
    membership = agent._membership
    membership._identity.revocations.update(data, pair.site.now())
    with pytest.raises(HangUp, match="revoked"):
        await agent.dial_master()


async def test_a_failed_start_keeps_no_connection(pair: SidecarPair, monkeypatch: pytest.MonkeyPatch) -> None:
    """A later call must not use the connection to an invalid master."""
    agent = pair.talker_sidecar._agent_for("/talker")
    session = agent._membership.session

    def refused(*_: object) -> None:
        raise HangUp("invalid identity")

    monkeypatch.setattr(session, "_refresh", refused)
    for _ in range(2):
        with pytest.raises(RossecError):
            await pair.talker.ask(pair.talker.master_uri, "getPid")
        with pytest.raises(RossecError, match="out of reach"):
            await session.forward("getPid", "/talker")


@pytest.mark.parametrize("restart", [False, True])
async def test_a_dead_program_does_not_replace_a_new_one_of_its_name(
    pair: SidecarPair, restart: bool, caplog: pytest.LogCaptureFixture
) -> None:
    """The master would shut down the new one: a node of the same name at another address."""
    caplog.set_level(logging.INFO)
    await pair.talker.register("registerPublisher", "/word", "std_msgs/String")
    await pair.talker.close()
    async with Program("/talker", pair.talker_sidecar) as successor:
        await successor.register("registerPublisher", "/word", "std_msgs/String")
        agent = pair.talker_sidecar._agent_for("/talker")
        if restart:
            await pair.site.restart_master()
        else:
            stream = agent._membership.session._stream
            assert stream is not None
            stream.abort("a cable is pulled")
        await until(lambda: "/talker: connected to the master again" in caplog.text, within=30)
        endpoint = ListeningAddress(
            WireProtocol.HTTP,
            "127.0.0.1",
            agent.open_ingress(local_endpoint(WireProtocol.HTTP, successor.slave.port)),
        )
        assert await agent.call_master("lookupNode", ("/talker", "/talker")) == [1, "node api", endpoint.uri]
        await pair.listener.register("registerSubscriber", "/word", "std_msgs/String")
        assert [method for method, _ in successor.calls if method == "shutdown"] == []


async def test_a_new_grant_takes_effect_while_the_program_runs(
    pair: SidecarPair, caplog: pytest.LogCaptureFixture
) -> None:
    """Refusals of the master are logged, with what is missing: a program may not print them."""
    talker = pair.talker
    wanted = ("registerPublisher", "/late", "std_msgs/String", talker.uri)
    refused = await talker.ask(talker.master_uri, *wanted)
    assert isinstance(refused, list)
    assert refused[0] == -1
    rule = "an allow rule for /talker with publish: [/late] would change it"
    await until(lambda: f"/talker may not publish /late: {rule}" in caplog.text, within=20)
    pair.site.publish("/talker", "/late")
    agent = pair.talker_sidecar._agent_for("/talker")
    access = agent.state.access
    await until(lambda: access.holds(Right.PUBLISH, "/late", pair.site.now()), within=20)
    assert await talker.register(*wanted[:3]) == []
