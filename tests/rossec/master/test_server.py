"""The running master over real secure connections on loopback, with a real authority."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ca.certificates import Identity
from ca.revocation import digest, open_timestamp
from grants.model import Right
from rossec.errors import AnswerRefused, RossecError
from rossec.master.limits import Limits
from rossec.master.registry import NodeRef
from rossec.master.server import PEER_CONNECTIONS, MasterServer
from rossec.master.trust import Trust
from rossec.net.rpc import RpcClient, serve_calls
from rossec.net.stream import Flavour, SecureStream, connect, serve
from rossec.ros.settings import parse_uri
from tests.support.authority import Member, Site

T = "std_msgs/String"
EVERYTHING = {"/**": Right(255)}


class SlaveNode:
    """An enrolled node: a control connection, and a slave API that records what it is told."""

    def __init__(self, world: "World", member: Member) -> None:
        self.world = world
        self.member = member
        self.told: list[tuple[Any, ...]] = []
        self.answer: list[Any] = [1, "", 0]

    async def start(self, rights: dict[str, Right]) -> None:
        self.server = serve(
            self.handle, "127.0.0.1", 0, self.member.credentials, self.world.site.anchor.verify
        )
        self.world.exit.push_async_callback(self.server.close)
        self.uri = f"http://127.0.0.1:{self.server.port}/"
        self.grant = self.world.site.grant(self.member, rights)
        self.client = await self.world.call_as(self.member)
        await self.ask("rossec.presentGrants", [self.grant])

    async def handle(self, stream: SecureStream[Identity]) -> None:
        await serve_calls(stream, self.dispatch)

    async def dispatch(self, method: str, params: tuple[object, ...], peer: Identity) -> object:
        self.told.append((peer.name, method, *params[1:]))
        return self.answer

    async def ask(self, method: str, *params: object) -> Any:
        return await self.client.ask(method, self.member.name, *params)

    def heard(self, method: str) -> list[tuple[Any, ...]]:
        return [call[2:] for call in self.told if call[1] == method]


class World:
    def __init__(self, exit_stack: AsyncExitStack) -> None:
        self.exit = exit_stack
        self.site = Site()
        self.master = self.site.enroll("/master")
        self.trust = Trust(
            self.site.anchor,
            self.master.credentials.signer,
            self.site.revocations(),
            lambda _: None,
        )
        self.trust.update(self.site.revoke(), self.site.now)

    async def start(self) -> None:
        self.server = MasterServer(
            self.master.credentials,
            self.site.anchor.verify,
            self.trust,
            host="127.0.0.1",
            port=0,
            advertise="127.0.0.1",
        )
        await self.server.start()
        self.exit.push_async_callback(self.server.close)

    async def node(self, name: str, rights: dict[str, Right] = EVERYTHING) -> SlaveNode:
        node = SlaveNode(self, self.site.enroll(name))
        await node.start(rights)
        return node

    async def call_as(self, member: Member) -> RpcClient:
        host, port = parse_uri(self.server.uri)
        stream = await connect(
            host, port, member.credentials, self.site.anchor.verify, opening=Flavour.HTTP
        )
        client = RpcClient(stream)
        self.exit.push_async_callback(client.close)
        return client


@pytest.fixture
async def world() -> AsyncIterator[World]:
    async with AsyncExitStack() as stack:
        world = World(stack)
        await world.start()
        yield world


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(30):
        while not condition():  # noqa: ASYNC110 - the condition is in another task's hands
            await asyncio.sleep(0.005)


async def ends(call: Awaitable[object]) -> None:
    with pytest.raises(RossecError):
        async with asyncio.timeout(30):
            await call


async def test_a_subscriber_hears_of_its_publishers(world: World) -> None:
    camera, viewer = await world.node("/camera"), await world.node("/viewer")
    assert await viewer.ask("registerSubscriber", "/image", T, viewer.uri) == []
    assert await camera.ask("registerPublisher", "/image", T, camera.uri) == [viewer.uri]
    await until(lambda: viewer.heard("publisherUpdate") == [("/image", [camera.uri])])
    assert viewer.told[0][0] == "/master"
    await camera.ask("unregisterPublisher", "/image", camera.uri)
    await until(lambda: viewer.heard("publisherUpdate")[1:] == [("/image", [])])
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
        await until(lambda: live.heard("publisherUpdate") == [("/t", [talker.uri])])


async def test_whoever_answers_must_be_the_registered_node(world: World) -> None:
    """Attack M8: the master never tells a node's news to somebody else."""
    liar, victim = await world.node("/liar"), await world.node("/victim")
    await liar.ask("registerSubscriber", "/t", T, victim.uri)
    await victim.ask("registerPublisher", "/t", T, "http://127.0.0.1:9/")
    other = await world.node("/other")
    await other.ask("registerSubscriber", "/t", T, other.uri)
    await other.ask("registerPublisher", "/t", T, other.uri)
    await until(lambda: other.heard("publisherUpdate") != [])
    assert victim.told == []


async def test_who_registers_the_address_of_another_is_removed(
    world: World, caplog: pytest.LogCaptureFixture
) -> None:
    squatter, victim = await world.node("/squatter"), await world.node("/victim")
    viewer = await world.node("/viewer")
    await viewer.ask("registerSubscriber", "/t", T, viewer.uri)
    await squatter.ask("registerPublisher", "/t", T, victim.uri)
    await squatter.ask("registerSubscriber", "/t", T, victim.uri)
    await viewer.ask("registerPublisher", "/t", T, viewer.uri)  # of which the squatter is told
    await until(lambda: viewer.heard("publisherUpdate")[-1:] == [("/t", [viewer.uri])])
    assert f"/squatter is removed: /victim answers at {victim.uri}" in caplog.text
    assert world.server._updates.nodes == (
        NodeRef("/viewer", viewer.uri, viewer.member.thumbprint),
    )
    assert await victim.ask("registerPublisher", "/t", T, victim.uri) == [viewer.uri]
    assert victim.told == []


async def test_who_comes_to_the_port_of_one_that_is_gone_is_let_in(
    world: World, caplog: pytest.LogCaptureFixture
) -> None:
    """The address is another's by the registry; whoever answers there, by its key, has it."""
    gone, heir = await world.node("/gone"), await world.node("/heir")
    await gone.ask("registerPublisher", "/t", T, heir.uri)
    assert await heir.ask("registerSubscriber", "/t", T, heir.uri) == []
    assert f"/gone is removed: /heir answers at {heir.uri}" in caplog.text
    assert "/heir may not" not in caplog.text
    eve = await world.node("/eve")
    with pytest.raises(AnswerRefused, match="registered by another node"):
        await eve.ask("registerSubscriber", "/t", T, heir.uri)
    assert caplog.text.count("/eve may not registerSubscriber") == 1
    assert await eve.ask("lookupNode", "/heir") == heir.uri


async def test_nobody_is_doubted_twice_at_a_time(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rossec.master.dialling.CALL_DEADLINE", 0.5)
    loop = asyncio.get_running_loop()
    with socket.create_server(("127.0.0.1", 0)) as silent:
        silent.setblocking(False)
        uri = f"http://127.0.0.1:{silent.getsockname()[1]}/"
        slow, eve, bob = [await world.node(name) for name in ("/slow", "/eve", "/bob")]
        await slow.ask("registerPublisher", "/t", T, uri)
        asked = asyncio.ensure_future(eve.ask("registerPublisher", "/t", T, uri))
        connected, _ = await loop.sock_accept(silent)
        with connected:
            with pytest.raises(AnswerRefused, match="registered by another node"):
                await bob.ask("registerPublisher", "/t", T, uri)
            assert not asked.done()
            with pytest.raises(AnswerRefused, match="registered by another node"):
                await asked
        assert world.server._dialler.doubted == set()
        assert await bob.ask("lookupNode", "/slow") == uri


async def test_a_revoked_node_is_told_nothing_more(world: World) -> None:
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
            [client] = world.server._updates.nodes
            assert client.name == "/dead"
            await other.ask("rossec.updateRevocations", world.site.revoke(dead.member))
            await until(lambda: client not in world.server._updates.nodes)


async def test_a_restarted_node_replaces_itself(world: World) -> None:
    node = await world.node("/node")
    await node.ask("registerPublisher", "/t", T, node.uri)
    await node.ask("registerPublisher", "/t", T, "http://127.0.0.1:9/")
    await until(lambda: node.heard("shutdown") != [])
    assert node.heard("shutdown") == [("[/node] Reason: new node registered with same name",)]


async def test_an_older_key_of_a_name_cannot_disturb_the_node(world: World) -> None:
    older = world.site.enroll("/viewer")
    viewer, camera = await world.node("/viewer"), await world.node("/camera")
    await viewer.ask("registerSubscriber", "/image", T, viewer.uri)
    thief = await world.call_as(older)
    assert isinstance(await thief.ask("getPid", "/viewer"), int)
    assert await thief.ask("unregisterSubscriber", "/viewer", "/image", viewer.uri) == 0
    await world.server._upkeep._enforce()
    assert await camera.ask("registerPublisher", "/image", T, camera.uri) == [viewer.uri]
    await until(lambda: viewer.heard("publisherUpdate") == [("/image", [camera.uri])])


async def test_news_for_one_key_never_goes_to_another_of_the_same_name(world: World) -> None:
    node, other = await world.node("/node"), await world.node("/other")
    newer = SlaveNode(world, world.site.enroll("/node"))
    await newer.start(EVERYTHING)
    await node.ask("registerSubscriber", "/t", T, newer.uri)
    await other.ask("registerSubscriber", "/t", T, other.uri)
    await other.ask("registerPublisher", "/t", T, other.uri)
    await until(lambda: other.heard("publisherUpdate") != [])
    assert newer.told == []


async def test_parameters_are_passed_on(world: World) -> None:
    one, two = await world.node("/one"), await world.node("/two")
    assert await one.ask("subscribeParam", one.uri, "/rate") == {}
    await two.ask("setParam", "/rate", 5)
    await until(lambda: one.heard("paramUpdate") == [("/rate/", 5)])


async def test_a_node_cannot_act_as_another(world: World) -> None:
    eve = await world.node("/eve")
    with pytest.raises(AnswerRefused, match="belongs to /eve"):
        await eve.client.ask("registerPublisher", "/victim", "/t", T, eve.uri)


async def test_a_revoked_grant_takes_the_registration_with_it(world: World) -> None:
    camera, viewer = await world.node("/camera"), await world.node("/viewer")
    await viewer.ask("registerSubscriber", "/image", T, viewer.uri)
    await camera.ask("registerPublisher", "/image", T, camera.uri)
    revocations = world.site.revoke(camera.grant)
    assert await viewer.ask("rossec.updateRevocations", revocations) == 1
    await until(lambda: viewer.heard("publisherUpdate")[-1:] == [("/image", [])])
    with pytest.raises(AnswerRefused, match="is revoked"):
        await camera.ask("registerPublisher", "/image", T, camera.uri)
    await until(lambda: len(viewer.heard("rossec.revocationUpdate")) > 0)
    data, stamp = viewer.heard("rossec.revocationUpdate")[-1]
    assert data == revocations
    opened = open_timestamp(stamp, world.master.identity.public_key)
    assert opened.digest == digest(revocations)


async def test_a_revoked_identity_is_cut_off_and_stays_out(world: World) -> None:
    camera, viewer = await world.node("/camera"), await world.node("/viewer")
    await viewer.ask("registerSubscriber", "/image", T, viewer.uri)
    await camera.ask("registerPublisher", "/image", T, camera.uri)
    await viewer.ask("rossec.updateRevocations", world.site.revoke(camera.member))
    await ends(camera.ask("getPid"))
    await until(lambda: viewer.heard("publisherUpdate")[-1:] == [("/image", [])])
    again = await world.call_as(camera.member)
    await ends(again.ask("getPid", "/camera"))
    state = await viewer.ask("getSystemState")
    assert state == [[], [["/image", ["/viewer"]]], []]


async def test_an_identity_has_so_many_connections(world: World) -> None:
    member = world.site.enroll("/many")
    clients = [await world.call_as(member) for _ in range(PEER_CONNECTIONS)]
    for client in clients:
        assert await client.ask("getUri", "/many") == world.server.uri
    await ends((await world.call_as(member)).ask("getUri", "/many"))
    other = await world.node("/other")
    assert await other.ask("getUri") == world.server.uri


async def test_an_administrator_stops_it(world: World) -> None:
    admin = await world.node("/admin", {"/master": Right.ADMIN})
    await admin.ask("shutdown", "maintenance")
    async with asyncio.timeout(30):
        await world.server.stopped()


async def test_refused_grants_are_audited_but_no_error(
    world: World, caplog: pytest.LogCaptureFixture
) -> None:
    node = await world.node("/node")
    member = world.site.enroll("/late")
    old = world.site.grant(member, EVERYTHING, start=-9 * 86400)
    late = await world.call_as(member)
    assert await late.ask("rossec.presentGrants", "/late", [old]) == 0
    assert "/late presents grants that are refused: " in caplog.text
    assert await node.ask("rossec.presentGrants", [old]) == 1


async def test_nobody_writes_lines_into_the_log(
    world: World, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    eve = await world.node("/eve", {"/eve/t": Right.SUBSCRIBE, "/master": Right.ADMIN})
    forged = "x\nrossec: WARNING: /robot is cut off\x9b31m\u202e"
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
    await robot.ask("registerPublisher", "/eve/t", T, robot.uri)  # eve is told at once
    await until(lambda: "/eve answers" in caplog.text)
    await eve.ask("shutdown", forged)
    messages = [record.getMessage() for record in caplog.records]
    assert any("stopping: /eve: x" in message for message in messages)
    assert [message for message in messages if not message.isprintable()] == []


async def test_denials_are_audited(world: World, caplog: pytest.LogCaptureFixture) -> None:
    eve = await world.node("/eve", {"/t": Right.CALL})
    with pytest.raises(AnswerRefused):
        await eve.ask("registerPublisher", "/t", T, eve.uri)
    assert "/eve may not registerPublisher: rossec: /eve needs the right publish" in caplog.text


async def test_a_watcher_waits_until_there_is_news(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    watcher, camera = await world.node("/watcher"), await world.node("/camera")
    whole = await watcher.ask("rossec.watchGraph", "", 0)
    assert whole["whole"]
    question = whole["instance"], whole["cursor"]
    waiting = asyncio.ensure_future(watcher.ask("rossec.watchGraph", *question))
    await camera.ask("registerPublisher", "/image", T, camera.uri)
    news = await waiting
    assert ["publisher", "/image", "/camera"] in news["added"]
    assert (news["whole"], news["instance"]) == (False, whole["instance"])
    assert news["version"] > whole["version"]
    monkeypatch.setattr("rossec.master.server.WATCH_WAIT", 0.05)
    quiet = await watcher.ask("rossec.watchGraph", news["instance"], news["cursor"])
    assert (quiet["added"], quiet["removed"], quiet["cursor"]) == ([], [], news["cursor"])


async def test_a_watcher_hears_that_a_node_was_revoked(world: World) -> None:
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
            news = await waiting
            gone += news["removed"]
            question = news["instance"], news["cursor"]
            waiting = asyncio.ensure_future(watcher.ask("rossec.watchGraph", *question))
    waiting.cancel()


async def test_a_fault_of_ours_does_not_end_freshness(
    world: World, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Timestamps go on, and rights are enforced, whatever one round of it met."""
    node = await world.node("/node")
    await node.ask("registerSubscriber", "/t", T, node.uri)
    told = world.trust.news_for

    def crash(*_: object) -> Any:
        monkeypatch.setattr(world.trust, "news_for", told)
        raise RuntimeError("a fault of ours")

    monkeypatch.setattr(world.trust, "news_for", crash)
    world.server._upkeep._changed.set()
    await until(lambda: "a fault of ours" in caplog.text)
    world.server._upkeep._changed.set()
    await until(lambda: node.heard("rossec.revocationUpdate") != [])


async def test_m8_a_node_elsewhere_does_not_live_on_the_masters_host(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    near, far = await world.node("/near"), world.site.enroll("/far")
    monkeypatch.setattr(SecureStream, "address", "192.0.2.7")
    client = await world.call_as(far)
    await client.ask("rossec.presentGrants", "/far", [world.site.grant(far, EVERYTHING)])
    with pytest.raises(AnswerRefused, match="on the master's host, and the caller is not"):
        await client.ask("registerPublisher", "/far", "/t", T, "http://127.0.0.1:9/")
    assert await client.ask("registerPublisher", "/far", "/t", T, "http://192.0.2.7:9/") == []
    monkeypatch.setattr(SecureStream, "local_address", "192.0.2.7")  # by another of its addresses
    same = await world.call_as(far)
    assert await same.ask("registerPublisher", "/far", "/t", T, "http://localhost:9/") == []
    assert await near.ask("registerPublisher", "/t", T, near.uri) == []


async def test_what_is_administered_is_audited(
    world: World, caplog: pytest.LogCaptureFixture
) -> None:
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
        f"/admin brought revocation list {number}",
        "/robot is cut off: the key of /robot is revoked",
        "/admin brought a delegation to renew grants",
    ]


async def test_a_long_multicall_keeps_nobody_waiting(world: World) -> None:
    """What a node may do is looked at anew, too, whenever others had their turn."""
    eve, other = await world.node("/eve"), await world.node("/other")
    calls = [
        {"methodName": "setParam", "params": ["/eve", f"/p{number}", 1]} for number in range(3000)
    ]
    asked = asyncio.ensure_future(eve.client.call("system.multicall", calls))
    await until(lambda: int(world.server.status()["calls"]) > 2)
    assert isinstance(await other.ask("getPid"), int)
    assert not asked.done()
    await other.ask("rossec.updateRevocations", world.site.revoke(eve.grant))
    answers: Any = await asked
    codes = [answer[0][0] for answer in answers]
    made = codes.count(1)
    assert 0 < made < 3000
    assert codes == [1] * made + [-1] * (3000 - made)
    short: Any = await eve.client.call("system.multicall", calls[:2])
    assert [answer[0][0] for answer in short] == [-1, -1]


async def test_a_revoked_identity_does_not_end_its_multicall(world: World) -> None:
    eve, other = await world.node("/eve"), await world.node("/other")
    calls = [
        {"methodName": "setParam", "params": ["/eve", f"/p{number}", 1]} for number in range(3000)
    ]
    asked = asyncio.ensure_future(eve.client.call("system.multicall", calls))
    await until(lambda: int(world.server.status()["calls"]) > 2)
    await other.ask("rossec.updateRevocations", world.site.revoke(eve.member))
    await ends(asked)
    assert not await other.ask("hasParam", "/p2999")


async def test_the_limits_of_a_call_are_those_of_the_configuration(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[dict[str, Any]] = []

    async def note(*args: Any, **limits: Any) -> None:
        given.append(limits)
        await serve_calls(*args, **limits)

    monkeypatch.setattr("rossec.master.server.serve_calls", note)
    world.server._limits = Limits(body=5000, request_seconds=7, idle_seconds=8)
    client = await world.call_as(world.site.enroll("/node"))
    assert isinstance(await client.ask("getPid", "/node"), int)
    assert given == [{"limit": 5000, "request_deadline": 7, "idle_deadline": 8}]


async def test_a_revoked_node_is_in_no_answer_from_the_moment_its_list_is_there(
    world: World,
) -> None:
    """Also within one multicall: before the list it is there, then it is not."""
    camera, viewer = await world.node("/camera"), await world.node("/viewer")
    await camera.ask("registerPublisher", "/image", T, camera.uri)
    await camera.ask("registerService", "/reset", "rosrpc://127.0.0.1:9", camera.uri)
    revoked = world.site.revoke(camera.member)
    asked = [
        ("getSystemState",), ("rossec.updateRevocations", revoked), ("getSystemState",),
        ("lookupNode", "/camera"), ("lookupService", "/reset"),
    ]  # fmt: skip
    calls = [{"methodName": name, "params": ["/viewer", *params]} for name, *params in asked]
    answers: Any = await viewer.client.call("system.multicall", calls)
    before, taken, after, node, service = (answer[0] for answer in answers)
    assert (before[2][0], taken[2]) == ([["/image", ["/camera"]]], 1)
    assert (after[2], node[0], service[0]) == ([[], [], []], -1, -1)
