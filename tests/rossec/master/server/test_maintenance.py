"""Rights that end while the master runs, over real connections."""

import asyncio
import os
import socket
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from ca.revocation.lists import digest, open_timestamp
from rossec.clock import Clock
from rossec.errors import AnswerRefused
from rossec.master.server import saved_state as module
from rossec.master.server.saved_state import ParameterFile
from tests.rossec.master.server.test_server import another
from tests.rossec.master.world import EVERYTHING, T, World, ends, until


async def test_a_revoked_node_receives_no_more_updates(world: World) -> None:
    loop = asyncio.get_running_loop()
    with socket.create_server(("127.0.0.1", 0)) as silent:
        silent.setblocking(False)
        dead, other = await world.node("/dead"), await world.node("/other")
        uri = f"http://127.0.0.1:{silent.getsockname()[1]}/"
        await dead.ask("registerSubscriber", "/t", T, uri)
        await other.ask("registerPublisher", "/t", T, other.uri)
        connected, _ = await loop.sock_accept(silent)
        with connected:
            assert await loop.sock_recv(connected, 1) != b""  # the handshake, never answered
            [client] = world.server.effects.updates.nodes
            assert client.name == "/dead"
            await other.ask("rossec.updateRevocations", world.site.revoke(dead.member))
            await until(lambda: client not in world.server.effects.updates.nodes)


async def test_an_older_key_of_a_name_cannot_disturb_the_node(world: World) -> None:
    older = world.site.enroll("/viewer")
    viewer, camera = await world.node("/viewer"), await world.node("/camera")
    await viewer.ask("registerSubscriber", "/image", T, viewer.uri)
    thief = await world.call_as(older)
    assert isinstance(await thief.ask("getPid", "/viewer"), int)
    assert await thief.ask("unregisterSubscriber", "/viewer", "/image", viewer.uri) == 0
    await world.server._maintenance._run_once()
    assert await camera.ask("registerPublisher", "/image", T, camera.uri) == [viewer.uri]
    await until(lambda: viewer.received_calls("publisherUpdate") == [("/image", [camera.uri])])


async def test_a_revoked_grant_removes_the_registration(world: World) -> None:
    camera, viewer = await world.node("/camera"), await world.node("/viewer")
    await viewer.ask("registerSubscriber", "/image", T, viewer.uri)
    await camera.ask("registerPublisher", "/image", T, camera.uri)
    revocations = world.site.revoke(camera.grant)
    assert await viewer.ask("rossec.updateRevocations", revocations) == 1
    await until(lambda: viewer.received_calls("publisherUpdate")[-1:] == [("/image", [])])
    with pytest.raises(AnswerRefused, match="is revoked"):
        await camera.ask("registerPublisher", "/image", T, camera.uri)
    await until(lambda: len(viewer.received_calls("rossec.revocationUpdate")) > 0)
    data, stamp = viewer.received_calls("rossec.revocationUpdate")[-1]
    assert data == revocations
    opened = open_timestamp(stamp, world.master.identity.public_key)
    assert opened.digest == digest(revocations)


async def test_a_revoked_identity_is_disconnected_and_stays_out(world: World) -> None:
    camera, viewer = await world.node("/camera"), await world.node("/viewer")
    await viewer.ask("registerSubscriber", "/image", T, viewer.uri)
    await camera.ask("registerPublisher", "/image", T, camera.uri)
    await viewer.ask("rossec.updateRevocations", world.site.revoke(camera.member))
    await ends(camera.ask("getPid"))
    await until(lambda: viewer.received_calls("publisherUpdate")[-1:] == [("/image", [])])
    again = await world.call_as(camera.member)
    await ends(again.ask("getPid", "/camera"))
    state = await viewer.ask("getSystemState")
    assert state == [[], [["/image", ["/viewer"]]], []]


async def test_a_watcher_is_notified_of_a_revoked_node(world: World) -> None:
    watcher, camera = await world.node("/watcher"), await world.node("/camera")
    await camera.ask("registerPublisher", "/image", T, camera.uri)
    whole = await watcher.ask("rossec.watchGraph", "", 0)
    question = whole["instance"], whole["cursor"]
    waiting = asyncio.ensure_future(watcher.ask("rossec.watchGraph", *question))
    other = await world.node("/other")
    await other.ask("rossec.updateRevocations", world.site.revoke(camera.member))
    gone: list[list[str]] = []
    async with asyncio.timeout(20):
        while ["publisher", "/image", "/camera"] not in gone:
            graph_changes = await waiting
            gone += graph_changes["removed"]
            question = graph_changes["instance"], graph_changes["cursor"]
            waiting = asyncio.ensure_future(watcher.ask("rossec.watchGraph", *question))
    waiting.cancel()


async def test_an_exception_does_not_end_freshness(
    world: World, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Timestamps are sent and rights enforced after a round that failed."""
    node = await world.node("/node")
    await node.ask("registerSubscriber", "/t", T, node.uri)
    received = world.trust.revocations_for

    def crash(*_: object) -> Any:
        monkeypatch.setattr(world.trust, "revocations_for", received)
        raise RuntimeError("a fault of ours")

    monkeypatch.setattr(world.trust, "revocations_for", crash)
    world.server.effects.list_changed.set()
    await until(lambda: "a fault of ours" in caplog.text)
    world.server.effects.list_changed.set()
    await until(lambda: node.received_calls("rossec.revocationUpdate") != [])


async def test_a_revoked_node_is_in_no_answer_once_the_list_is_delivered(world: World) -> None:
    """Also within one multicall: it is listed before the revocation list, and not after."""
    camera, viewer = await world.node("/camera"), await world.node("/viewer")
    await camera.ask("registerPublisher", "/image", T, camera.uri)
    await camera.ask("registerService", "/reset", "rosrpc://127.0.0.1:9", camera.uri)
    revoked = world.site.revoke(camera.member)
    elements = [
        ("getSystemState",),
        ("rossec.updateRevocations", revoked),
        ("getSystemState",),
        ("lookupNode", "/camera"),
        ("lookupService", "/reset"),
    ]
    calls = [{"methodName": name, "params": ["/viewer", *params]} for name, *params in elements]
    answers: Any = await viewer.client.call("system.multicall", calls)
    before, taken, after, node, service = (answer[0] for answer in answers)
    assert (before[2][0], taken[2]) == ([["/image", ["/camera"]]], 1)
    assert (after[2], node[0], service[0]) == ([[], [], []], -1, -1)


async def test_a_clock_set_back_is_logged_and_ends_nothing(
    world: World, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    shows = time.time()
    monkeypatch.setattr("rossec.clock.HOST", Clock(lambda: shows, lambda: 0.0))
    camera = await world.node("/camera")
    shows -= 3600
    await world.server._maintenance._run_once()
    _, stamp = await camera.ask("rossec.revocations")
    issued = open_timestamp(stamp, world.master.identity.public_key).issued
    assert issued == int(shows) + 3600
    assert "restart the master" in caplog.text


async def test_a_disk_that_hangs_delays_no_revocation(
    world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Parameters are saved beside the rounds."""
    hangs, go_on = threading.Event(), threading.Event()

    def sync(_: int) -> None:
        hangs.set()
        assert go_on.wait(30)

    file, member, victim = ParameterFile(tmp_path / "p"), *map(world.site.enroll, ("/a", "/b"))
    async with another(world, parameter_file=file):
        monkeypatch.setattr(module, "GROWN", 0)
        monkeypatch.setattr(os, "fdatasync", sync)
        client, cut = await world.call_as(member), await world.call_as(victim)
        shown = [world.site.grant(member, EVERYTHING)]
        await client.ask("rossec.presentGrants", "/a", shown)
        await client.ask("setParam", "/a", "/rate", 5)
        assert await asyncio.to_thread(hangs.wait, 30)
        await client.ask("rossec.updateRevocations", "/a", world.site.revoke(victim))
        await ends(cut.ask("getUri", "/b"))
        await client.ask("setParam", "/a", "/rate", 6)
        monkeypatch.setattr(file, "save", lambda: 1 / 0)
        go_on.set()
        await until(lambda: "parameters were not saved; it is tried again" in caplog.text)
    again = ParameterFile(tmp_path / "p")
    again.open()
    assert again.parameters.get("/rate") == 6
    again.close()
