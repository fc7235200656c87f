"""Updates to nodes and lines of the log after a call, over real connections."""

import asyncio
import contextlib
import logging
import socket
from collections.abc import Iterator
from typing import Any

import pytest

from ca.certificates import Identity
from grants.model import Right
from rossec.errors import AnswerRefused
from rossec.master.api.methods import RevocationsChanged
from rossec.master.rights.caller import Caller
from rossec.net.aio import SecureStream
from tests.rossec.master.world import EVERYTHING, T, World, ends, until
from tests.support.caller import caller
from tests.support.site import Site


async def test_a_subscriber_is_notified_of_its_publishers(world: World) -> None:
    camera, viewer = await world.node("/camera"), await world.node("/viewer")
    assert await viewer.ask("registerSubscriber", "/image", T, viewer.uri) == []
    assert await camera.ask("registerPublisher", "/image", T, camera.uri) == [viewer.uri]
    await until(lambda: viewer.received_calls("publisherUpdate") == [("/image", [camera.uri])])
    assert viewer.received[0][0] == "/master"
    await camera.ask("unregisterPublisher", "/image", camera.uri)
    await until(lambda: viewer.received_calls("publisherUpdate")[1:] == [("/image", [])])
    assert await camera.ask("getUri") == world.server.uri


async def test_three_dead_subscribers_do_not_delay_a_live_one(world: World) -> None:
    """Attack M9: ports that accept and never answer."""
    with socket.create_server(("0.0.0.0", 0), backlog=64) as silent:
        for n in range(2, 5):  # loopback has 16 million addresses: one per dead node
            dead = await world.node(f"/dead{n}")
            uri = f"http://127.0.0.{n}:{silent.getsockname()[1]}/"
            await dead.ask("registerSubscriber", "/t", T, uri)
        live, talker = await world.node("/live"), await world.node("/talker")
        await live.ask("registerSubscriber", "/t", T, live.uri)
        await talker.ask("registerPublisher", "/t", T, talker.uri)
        await until(lambda: live.received_calls("publisherUpdate") == [("/t", [talker.uri])])


async def test_a_restarted_node_replaces_itself(world: World) -> None:
    node = await world.node("/node")
    await node.ask("registerPublisher", "/t", T, node.uri)
    await node.ask("registerPublisher", "/t", T, "http://127.0.0.1:9/")
    await until(lambda: node.received_calls("shutdown") != [])
    assert node.received_calls("shutdown") == [("[/node] Reason: new node registered with same name",)]


async def test_parameter_updates_are_sent(world: World) -> None:
    one, two = await world.node("/one"), await world.node("/two")
    assert await one.ask("subscribeParam", one.uri, "/rate") == {}
    await two.ask("setParam", "/rate", 5)
    await until(lambda: one.received_calls("paramUpdate") == [("/rate/", 5)])


async def test_an_administrator_stops_the_master(world: World) -> None:
    admin = await world.node("/admin", {"/master": Right.ADMIN})
    await admin.ask("shutdown", "maintenance")
    async with asyncio.timeout(30):
        await world.server.stopped()


@pytest.mark.attack("revocation-at-scale")
async def test_the_revoked_are_cut_before_rights_are_checked_and_lines_written(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of all that are connected, first those that the list names."""
    events: list[str] = []
    members = [world.site.enroll(f"/n{number}") for number in range(6)]
    for member in members:
        await (await world.call_as(member)).ask("getPid", member.name)
    effects, trust = world.server.effects, world.trust
    caller, enforcement = trust.caller, effects.enforcement

    def judged(peer: Identity, now: int) -> Caller:
        events.append(f"judged {peer.name}")
        return caller(peer, now)

    def enforced() -> Iterator[None]:
        events.append("registrations")
        return enforcement()

    class Written(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if "disconnected" in record.getMessage():
                events.append("written")

    disconnect, audit, handler = SecureStream.disconnect, logging.getLogger("rossec.audit"), Written()

    def cut(stream: SecureStream[Identity]) -> None:
        events.append(f"cut {stream.peer.name}")
        disconnect(stream)

    monkeypatch.setattr(trust, "caller", judged)
    monkeypatch.setattr(effects, "enforcement", enforced)
    monkeypatch.setattr(SecureStream, "disconnect", cut)
    audit.addHandler(handler)
    try:
        keys = [members[number].identity.thumbprint for number in (3, 5)]
        trust.update(world.site.revoke(*keys), world.site.now)
        effects.deliver(RevocationsChanged("/ca"))
    finally:
        audit.removeHandler(handler)
    begin = events.index("registrations")
    assert {events[0], events[2]} == {"judged /n3", "judged /n5"}
    assert {events[1], events[3]} == {"cut /n3", "cut /n5"}
    assert events[begin - 2 : begin] == ["written"] * 2
    assert sorted(stream.peer.name for stream in world.server.state.streams) == ["/n0", "/n1", "/n2", "/n4"]


async def test_streams_are_found_by_the_group_that_shares_a_limit(world: World) -> None:
    member, other = world.site.enroll("/one"), world.site.enroll("/other")
    for each in (member, member, other):
        await (await world.call_as(each)).ask("getPid", each.name)
    streams = world.server.state.streams
    assert len(list(streams)) == 3
    of_member = streams.of_group(member.identity.thumbprint)
    assert [stream.peer.name for stream in of_member] == ["/one", "/one"]
    for stream in of_member:
        streams.discard(stream)
        streams.discard(stream)
    assert streams.of_group(member.identity.thumbprint) == []
    assert [stream.peer.name for stream in streams] == ["/other"]
    assert list(streams._members) == [other.identity.thumbprint], "who has gone leaves nothing"


async def test_refused_grants_are_audited_without_an_error(
    world: World, caplog: pytest.LogCaptureFixture
) -> None:
    node = await world.node("/node")
    member = world.site.enroll("/late")
    old = world.site.grant(member, EVERYTHING, start=-9 * 86400)
    late = await world.call_as(member)
    assert await late.ask("rossec.presentGrants", "/late", [old]) == 0
    assert "/late presented grants that are refused: " in caplog.text
    assert await node.ask("rossec.presentGrants", [old]) == 1


async def test_line_breaks_do_not_reach_the_log(world: World, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    eve = await world.node("/eve", {"/eve/t": Right.SUBSCRIBE, "/master": Right.ADMIN})
    forged = "x\nrossec: WARNING: /robot is disconnected\x9b31m\u202e"
    for method, *params in (
        ("getParam", f"/{forged}"),
        ("setParam", f"/{forged}", 1),
        ("setParam", "/a", {forged: 1}),
        ("lookupNode", f"/{forged}"),
        ("lookupService", f"/{forged}"),
        ("registerPublisher", "/t", f"a/{forged}", eve.uri),
        ("rossec.presentGrants", [forged.encode()]),
        ("rossec.updateRevocations", forged.encode()),
    ):
        with contextlib.suppress(AnswerRefused):
            await eve.ask(method, *params)
    eve.answer = [-1, forged, 0]
    await eve.ask("registerSubscriber", "/eve/t", T, eve.uri)
    robot = await world.node("/robot", {"/eve/t": Right.PUBLISH})
    await robot.ask("registerPublisher", "/eve/t", T, robot.uri)  # eve is notified at once
    await until(lambda: "/eve answers" in caplog.text)
    await eve.ask("shutdown", forged)
    messages = [record.getMessage() for record in caplog.records]
    assert any("stopping: /eve: x" in message for message in messages)
    assert [message for message in messages if not message.isprintable()] == []


async def test_denials_are_audited(world: World, caplog: pytest.LogCaptureFixture) -> None:
    eve = await world.node("/eve", {"/t": Right.CALL})
    with pytest.raises(AnswerRefused):
        await eve.ask("registerPublisher", "/t", T, eve.uri)
    assert "/eve may not publish /t (registerPublisher): an allow rule for /eve with" in caplog.text


async def test_administration_is_audited(world: World, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "rossec.audit")
    admin, robot = await world.node("/admin"), await world.node("/robot", {"/t": Right.PUBLISH})
    await robot.ask("registerPublisher", "/t", T, robot.uri)
    await admin.client.ask("unregisterPublisher", "/robot", "/t", robot.uri)
    await admin.ask("rossec.updateRevocations", world.site.revoke(robot.member))
    await admin.ask("rossec.updateDelegation", world.site.delegation(world.master))
    lines = [record.getMessage() for record in caplog.records if record.name == "rossec.audit"]
    number = world.trust.number
    assert lines == [
        "/admin calls unregisterPublisher for /robot: Unregistered [/robot] as provider of [/t]",
        f"/admin delivered revocation list {number}",
        "/robot is disconnected: the key of /robot is revoked",
        "/admin delivered a delegation to renew grants",
    ]


async def test_a_new_list_removes_registrations_and_is_sent_to_the_others(world: World) -> None:
    camera, viewer = await world.node("/camera"), await world.node("/viewer")
    await viewer.ask("registerSubscriber", "/image", T, viewer.uri)
    await camera.ask("registerPublisher", "/image", T, camera.uri)
    revoked = world.site.revoke(camera.grant)
    await camera.ask("rossec.updateRevocations", revoked)
    await until(lambda: ("/image", []) in viewer.received_calls("publisherUpdate"))
    await until(lambda: viewer.received_calls("rossec.revocationUpdate") != [])
    data, timestamp = viewer.received_calls("rossec.revocationUpdate")[-1]
    assert data in (b"", revoked)
    assert timestamp


async def test_updates_of_a_revoked_node_are_dropped(world: World) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        gone, talker = await world.node("/gone"), await world.node("/talker")
        uri = f"http://127.0.0.1:{silent.getsockname()[1]}/"
        await gone.ask("registerSubscriber", "/t", T, uri)
        await talker.ask("registerPublisher", "/t", T, talker.uri)
        updates = world.server.effects.updates
        assert [node.name for node in updates.nodes] == ["/gone"]
        await talker.ask("rossec.updateRevocations", world.site.revoke(gone.member))
        assert [node for node in updates.nodes if node.name == "/gone"] == []
        await ends(gone.ask("getPid"))


async def test_a_node_that_registers_the_address_of_another_is_removed(
    world: World, caplog: pytest.LogCaptureFixture
) -> None:
    squatter, victim = await world.node("/squatter"), await world.node("/victim")
    viewer = await world.node("/viewer")
    await viewer.ask("registerSubscriber", "/t", T, viewer.uri)
    await squatter.ask("registerPublisher", "/t", T, victim.uri)
    await squatter.ask("registerSubscriber", "/t", T, victim.uri)
    await viewer.ask("registerPublisher", "/t", T, viewer.uri)  # of which the squatter is notified
    await until(lambda: viewer.received_calls("publisherUpdate")[-1:] == [("/t", [viewer.uri])])
    assert f"/squatter is removed: /victim answers at {victim.uri}" in caplog.text
    assert victim.received == []


async def test_a_deposit_is_audited_and_ends_the_waits_of_its_holders(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    data = site.publish("/robot", "/p")
    async with caller(site, "/ca") as office, caller(site, "/robot") as robot:
        waiting = asyncio.ensure_future(robot("rossec.watchGrants", b""))
        assert site.master is not None
        state = site.master.state
        await until(lambda: len(state.grant_changes) == 1)
        assert (await office("rossec.depositGrants", [data]))[2] == [""]
        async with asyncio.timeout(30):
            assert (await waiting)[2]["grants"] == [data]
        assert "/ca deposited 1 grants for 1 keys" in caplog.text
        revoked = site.revoke(data)
        assert (await office("rossec.updateRevocations", revoked))[0] == 1
        assert state.deposit_file is not None
        assert len(state.deposit_file.deposits) == 0, "before the call is answered"


async def test_a_node_that_accepts_a_list_holds_it(world: World) -> None:
    camera, stubborn = await world.node("/camera"), await world.node("/stubborn")
    stubborn.answer = [-1, "no", 0]
    for node in (camera, stubborn):
        await node.ask("registerPublisher", "/t", T, node.uri)
    office = await world.call_as(world.site.enroll("/ca"))
    gone = world.site.enroll("/gone")
    await camera.ask("rossec.updateRevocations", world.site.revoke(gone))

    async def trust_status() -> Any:
        return await office.ask("rossec.revocationStatus", "/ca")

    async with asyncio.timeout(30):
        while (found := await trust_status())["holding"] != 1:  # noqa: ASYNC110 - at the master
            await asyncio.sleep(0.01)
    assert found == {"list": "1.2", "nodes": 2, "holding": 1, "lacking": ["/stubborn"]}


async def test_a_denied_right_is_told_to_the_authority_alone(world: World) -> None:
    eve = await world.node("/eve", {"/other": Right.PUBLISH})
    for _ in range(2):
        with pytest.raises(AnswerRefused):
            await eve.ask("registerSubscriber", "/scan", T, eve.uri)
    office = await world.call_as(world.site.enroll("/ca"))
    answer: Any = await office.ask("rossec.recentDenials", "/ca")
    ((ago, *denied),) = answer
    assert 0 <= ago <= 30
    assert denied == ["/eve", int(Right.SUBSCRIBE), "/scan"]
    with pytest.raises(AnswerRefused, match="only the authority's own node"):
        await eve.ask("rossec.recentDenials")
