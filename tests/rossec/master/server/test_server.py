"""Connections and calls of the running master, over real secure connections on loopback."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from rossec.errors import AnswerRefused
from rossec.master.api.dispatch import MAX_CONNECTIONS
from rossec.master.operation.config import MasterLimits
from rossec.master.rights.held_grants import verifier
from rossec.master.server.saved_state import DepositFile, ParameterFile
from rossec.master.server.server import PEER_CONNECTIONS, MasterServer
from rossec.net.aio import SecureStream
from rossec.net.rpc.calls import serve_calls
from tests.rossec.master.world import EVERYTHING, T, World, ends, until


@asynccontextmanager
async def another(world: World, **options: Any) -> AsyncIterator[MasterServer]:
    """Another master of the same site, in place of the first."""
    first, made = world.server, world.made(**options)
    await made.start()
    world.server = made
    try:
        yield made
    finally:
        world.server = first
        await made.close()


async def test_a_node_cannot_act_as_another(world: World) -> None:
    eve = await world.node("/eve")
    with pytest.raises(AnswerRefused, match="belongs to /eve"):
        await eve.client.ask("registerPublisher", "/victim", "/t", T, eve.uri)


async def test_the_connections_of_an_identity_are_limited(world: World) -> None:
    member = world.site.enroll("/many")
    first = await world.call_as(member)
    shown = [world.site.grant(member, EVERYTHING)]
    await first.ask("rossec.presentGrants", "/many", shown)  # without a right it has fewer
    clients = [first, *[await world.call_as(member) for _ in range(PEER_CONNECTIONS - 1)]]
    for client in clients:
        assert await client.ask("getUri", "/many") == world.server.uri
    await ends((await world.call_as(member)).ask("getUri", "/many"))
    other = await world.node("/other")
    assert await other.ask("getUri") == world.server.uri


async def test_a_watcher_waits_for_a_change(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    watcher, camera = await world.node("/watcher"), await world.node("/camera")
    whole = await watcher.ask("rossec.watchGraph", "", 0)
    assert whole["whole"]
    question = whole["instance"], whole["cursor"]
    waiting = asyncio.ensure_future(watcher.ask("rossec.watchGraph", *question))
    await camera.ask("registerPublisher", "/image", T, camera.uri)
    find_revocations = await waiting
    assert ["publisher", "/image", "/camera"] in find_revocations["added"]
    assert (find_revocations["whole"], find_revocations["instance"]) == (False, whole["instance"])
    assert find_revocations["version"] > whole["version"]
    monkeypatch.setattr("rossec.master.server.answers.WATCH_WAIT", 0.05)
    unchanged = await watcher.ask(
        "rossec.watchGraph", find_revocations["instance"], find_revocations["cursor"]
    )
    assert (unchanged["added"], unchanged["removed"], unchanged["cursor"]) == (
        [],
        [],
        find_revocations["cursor"],
    )


async def test_m8_a_node_on_another_host_cannot_register_loopback(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    near, far = await world.node("/near"), world.site.enroll("/far")
    remote = property(lambda _: "192.0.2.7", lambda _, address: None)
    monkeypatch.setattr(SecureStream, "address", remote, raising=False)
    client = await world.call_as(far)
    await client.ask("rossec.presentGrants", "/far", [world.site.grant(far, EVERYTHING)])
    with pytest.raises(AnswerRefused, match="on the master's host, and the caller is not"):
        await client.ask("registerPublisher", "/far", "/t", T, "http://127.0.0.1:9/")
    assert await client.ask("registerPublisher", "/far", "/t", T, "http://192.0.2.7:9/") == []
    monkeypatch.setattr(SecureStream, "local_address", "192.0.2.7")  # by another of its addresses
    same = await world.call_as(far)
    assert await same.ask("registerPublisher", "/far", "/t", T, "http://localhost:9/") == []
    assert await near.ask("registerPublisher", "/t", T, near.uri) == []


async def test_a_long_multicall_does_not_delay_others(world: World) -> None:
    """The rights of the caller are also checked again in every turn."""
    eve, other = await world.node("/eve"), await world.node("/other")
    calls = [{"methodName": "setParam", "params": ["/eve", f"/p{number}", 1]} for number in range(2000)]
    pending = asyncio.ensure_future(eve.client.call("system.multicall", calls))
    await until(lambda: int(world.server.status()["calls"]) > 2)
    assert isinstance(await other.ask("getPid"), int)
    assert not pending.done()
    await other.ask("rossec.updateRevocations", world.site.revoke(eve.grant))
    answers: Any = await pending
    codes = [answer[0][0] for answer in answers]
    made = codes.count(1)
    assert 0 < made < 2000
    assert codes == [1] * made + [-1] * (2000 - made)
    short: Any = await eve.client.call("system.multicall", calls[:2])
    assert [answer[0][0] for answer in short] == [-1, -1]


async def test_a_revoked_identity_does_not_end_its_multicall(world: World) -> None:
    eve, other = await world.node("/eve"), await world.node("/other")
    calls = [{"methodName": "setParam", "params": ["/eve", f"/p{number}", 1]} for number in range(3000)]
    pending = asyncio.ensure_future(eve.client.call("system.multicall", calls))
    await until(lambda: int(world.server.status()["calls"]) > 2)
    await other.ask("rossec.updateRevocations", world.site.revoke(eve.member))
    await ends(pending)
    assert not await other.ask("hasParam", "/p2999")


async def test_the_limits_of_a_call_are_those_of_the_configuration(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[dict[str, Any]] = []

    async def note(*args: Any, bound: Callable[[], int], **limits: Any) -> None:
        given.append({**limits, "bound": bound()})
        await serve_calls(*args, bound=bound, **limits)

    monkeypatch.setattr("rossec.master.server.server.serve_calls", note)
    limits = MasterLimits(body=5000, request_seconds=7, idle_seconds=8, body_without_right=4000)
    async with another(world, limits=limits):
        client = await world.call_as(world.site.enroll("/node"))
        assert isinstance(await client.ask("getPid", "/node"), int)
    assert given == [{"limit": 5000, "request_deadline": 7, "idle_deadline": 8, "bound": 4000}]


async def test_parameters_and_deposits_survive_a_restart(world: World, tmp_path: Path) -> None:
    admin = await world.node("/ca")
    robot = world.site.enroll("/robot")
    deposit = world.site.grant(robot, EVERYTHING)

    def files() -> dict[str, Any]:
        deposits = DepositFile(tmp_path / "deposits", verifier(world.site.anchor, world.trust.check))
        return {"parameter_file": ParameterFile(tmp_path / "parameters"), "deposit_file": deposits}

    async with another(world, **files()):
        client = await world.call_as(admin.member)
        await client.ask("rossec.presentGrants", "/ca", [admin.grant])
        await client.ask("setParam", "/ca", "/rate", 5)
        assert await client.ask("rossec.depositGrants", "/ca", [deposit]) == [""]
    async with another(world, **files()):
        client = await world.call_as(admin.member)
        await client.ask("rossec.presentGrants", "/ca", [admin.grant])
        assert await client.ask("getParam", "/ca", "/rate") == 5
        waiting: Any = await (await world.call_as(robot)).ask("rossec.watchGrants", "/robot", b"")
        assert waiting["grants"] == [deposit]


async def test_it_stops_when_it_is_told(world: World, caplog: pytest.LogCaptureFixture) -> None:
    stopped = asyncio.ensure_future(world.server.stopped())
    await asyncio.sleep(0)
    assert not stopped.done()
    world.server.stop("maintenance")
    async with asyncio.timeout(30):
        await stopped
    assert "stopping: maintenance" in caplog.text
    await world.server.close()
    assert world.server.status()["connections"] == 0


async def test_a_revoked_identity_is_sent_only_the_list(
    world: World, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    eve, other = await world.node("/eve"), await world.node("/other")
    revoked = world.site.revoke(eve.member)
    await other.ask("rossec.updateRevocations", revoked)
    client = await world.call_as(eve.member)
    assert await client.ask("rossec.revocations", "/eve") == [revoked, b""]
    await ends(client.ask("getPid", "/eve"))
    assert "/eve is sent only the revocation list: " in caplog.text
    assert world.server.status()["nodes"] == 0


async def test_connections_of_a_revoked_identity_are_few_and_short(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rossec.master.server.server.CONNECTION_SECONDS", 0.5)
    eve, other = await world.node("/eve"), await world.node("/other")
    await other.ask("rossec.updateRevocations", world.site.revoke(eve.member))
    clients = [await world.call_as(eve.member) for _ in range(MAX_CONNECTIONS + 1)]
    await ends(clients[-1].ask("rossec.revocations", "/eve"))
    await until(lambda: world.server.status()["connections"] == 1)  # the other's
    for client in clients:
        await ends(client.ask("rossec.revocations", "/eve"))
    again = await world.call_as(eve.member)
    assert await again.ask("rossec.revocations", "/eve")
