"""Two sidecars and plain programs in one process: what passes, what does not, what is cut."""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest

from grants.model import Restriction, Right, filter_rules
from rossec.channel.opening import Flavour
from rossec.errors import RossecError
from rossec.net.dial import dial
from rossec.ros.settings import parse_uri
from rossec.ros.xmlrpc import Fault
from rossec.sidecar.addresses import Endpoint, inside
from rossec.sidecar.server import Sidecar
from tests.rossec.sidecar.program import Program, sidecar, word
from tests.support.site import Site
from tests.support.witness import until


@dataclass
class Pair:
    site: Site
    near: Sidecar
    far: Sidecar
    talker: Program
    listener: Program


@pytest.fixture
async def pair(tmp_path: Path) -> AsyncIterator[Pair]:
    site = Site(tmp_path / "site")
    site.publish("/talker", "/word")
    site.grant("/talker", Right.PROVIDE, "/say")
    site.subscribe("/listener", "/word")
    site.grant("/listener", Right.CALL, "/say")
    async with (
        site.running(),
        sidecar(site) as near,
        sidecar(site) as far,
        Program("/talker", near) as talker,
        Program("/listener", far) as listener,
    ):
        yield Pair(site, near, far, talker, listener)


async def connect(pair: Pair) -> tuple[object, object]:
    """Publisher and subscriber in conversation; both plain ends."""
    await pair.talker.register("registerPublisher", "/word", "std_msgs/String")
    uris = await pair.listener.register("registerSubscriber", "/word", "std_msgs/String")
    assert isinstance(uris, list)
    stream, answer = await pair.listener.subscribe(uris[0], "/word")
    assert "error" not in answer, answer
    await pair.talker.connected.wait()
    return stream, pair.talker.connections[-1]


async def heard(stream: object, wanted: int) -> bytes:
    data = b""
    while len(data) < wanted:
        data += await stream.receive()  # type: ignore[attr-defined]
    return data


async def ends(stream: object) -> None:
    """Wait until the stream is at its end, whatever comes before."""
    with contextlib.suppress(RossecError):
        async with asyncio.timeout(10):
            while True:
                await stream.receive()  # type: ignore[attr-defined]


async def test_messages_pass_unchanged_and_large_ones_in_pieces(pair: Pair) -> None:
    stream, source = await connect(pair)
    message = word("hello") + word("x" * 3_000_000)
    sending = asyncio.ensure_future(source.send(message))  # type: ignore[attr-defined]
    assert await heard(stream, len(message)) == message
    await sending
    assert b"rossec_grants" not in str(pair.talker.headers).encode()


async def test_both_ends_go_together(pair: Pair) -> None:
    stream, source = await connect(pair)
    await source.close()  # type: ignore[attr-defined]
    await ends(stream)
    stream, source = await connect(pair)
    stream.abort()  # type: ignore[attr-defined]
    await ends(source)


async def test_a_restricted_subscriber_sees_what_it_may(pair: Pair) -> None:
    rules = filter_rules({"data": {"truncate": {"length": 2}}})
    for file in pair.site.enroll("/listener").path.glob("grants/*"):
        file.unlink()
    restriction = Restriction("std_msgs/String", ('msg.data != "secret"',), rules)
    pair.site.subscribe("/listener", "/word", restriction)
    stream, source = await connect(pair)
    await source.send(word("hello") + word("secret") + word("world"))  # type: ignore[attr-defined]
    expected = word("he") + word("wo")
    assert await heard(stream, len(expected)) == expected


async def test_services_pass_both_ways(pair: Pair) -> None:
    uri = f"rosrpc://127.0.0.1:{pair.talker.topics.port}"
    await pair.talker.register("registerService", "/say", uri)
    answer = await pair.listener.ask(pair.listener.master_uri, "lookupService", "/say")
    assert isinstance(answer, list)
    stream, fields = await pair.listener.call(answer[2], "/say")
    assert "error" not in fields
    await stream.send(word("echo"))
    assert await heard(stream, len(word("echo"))) == word("echo")


async def test_a_program_that_may_not_is_told_why(pair: Pair) -> None:
    site = pair.site
    async with Program("/stranger", pair.far) as stranger:
        answer = await stranger.ask(stranger.master_uri, "getPid")
        assert isinstance(answer, list)
        assert "has no identity here (enroll it: rossec node request /stranger" in answer[1]
        site.enroll("/stranger")
        await pair.talker.register("registerPublisher", "/word", "std_msgs/String")
        known = await pair.listener.register("registerSubscriber", "/word", "std_msgs/String")
        assert isinstance(known, list)
        # It knows where the talker is, and asks there without the master (attack N5).
        agent = pair.far._agent_for("/stranger")
        remote = pair.far._agent_for("/listener").tenant.doors
        place = next(iter(remote._imported.values()))
        answer = await stranger.ask(stranger.master_uri, "getPid")
        door = f"http://127.0.0.1:{agent.bring(place)}/"
        _, fields = await stranger.subscribe(door, "/word")
        assert b"no grant" in fields["error"]
    assert not pair.talker.connections


async def test_revocation_cuts_the_conversation(pair: Pair) -> None:
    stream, source = await connect(pair)
    data = pair.site.revoke(pair.site.identity("/listener").thumbprint)
    assert pair.site.master is not None
    await pair.talker.ask(pair.talker.master_uri, "getPid")
    agent = pair.near._agent_for("/talker")
    await agent._session.call("rossec.updateRevocations", data)
    await ends(stream)
    await ends(source)


async def test_an_expired_grant_cuts_the_conversation(pair: Pair) -> None:
    for file in pair.site.enroll("/listener").path.glob("grants/*"):
        file.unlink()
    pair.site.subscribe("/listener", "/word", lifetime=3)
    stream, source = await connect(pair)
    await ends(stream)
    await ends(source)


async def test_a_guard_that_crashes_lets_nothing_through(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    for file in pair.site.enroll("/listener").path.glob("grants/*"):
        file.unlink()
    rules = filter_rules({"data": {"truncate": {"length": 2}}})
    pair.site.subscribe("/listener", "/word", Restriction("std_msgs/String", (), rules))
    stream, source = await connect(pair)

    def crash(*_: object) -> None:
        raise ArithmeticError

    monkeypatch.setattr("grants.guard.Guard.treat", crash)
    await source.send(word("hello"))  # type: ignore[attr-defined]
    with pytest.raises(RossecError):
        await heard(stream, 1)
    await ends(source)


async def test_without_news_of_revocations_the_conversation_is_cut(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream, source = await connect(pair)
    later = SimpleNamespace(time=lambda: time.time() + 200)
    monkeypatch.setattr("rossec.node.watch.time", later)
    await ends(stream)
    await ends(source)


async def test_an_identity_that_nobody_watches_over_serves_nobody(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream, source = await connect(pair)
    agent = pair.near._agent_for("/talker")

    def crash(_: int) -> None:
        raise ArithmeticError

    monkeypatch.setattr(agent._watch, "cut", crash)
    await ends(stream)
    await ends(source)
    with pytest.raises(RossecError):
        await pair.talker.ask(pair.talker.master_uri, "getPid")


async def test_old_doors_make_room(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    stream, source = await connect(pair)
    for name in ("/talker", "/listener"):
        agent = (pair.near if name == "/talker" else pair.far)._agent_for(name)
        for table in (agent._exports, agent._imports):
            monkeypatch.setattr(table, "_limit", 4)
        far = [Endpoint(Flavour.TCPROS, "127.0.0.9", port) for port in range(1, 9)]
        ports = [agent.tenant.doors.opened_inside(place, agent.bring(place)).port for place in far]
        assert agent.tenant.doors.peer_behind(inside(Flavour.TCPROS, ports[-1])) == far[-1]
        assert agent.tenant.doors.peer_behind(inside(Flavour.TCPROS, ports[0])) is None
        for port in range(1, 9):
            agent.export(inside(Flavour.HTTP, port))
        assert len(list(agent._exports)) == len(list(agent._imports)) == 4
    await source.send(word("still"))  # type: ignore[attr-defined]
    assert await heard(stream, len(word("still"))) == word("still")


async def test_a_program_returns_to_a_topic_that_it_lost(pair: Pair) -> None:
    """Stock rospy waits until the publisher is named again."""
    stream, source = await connect(pair)
    before = len(pair.listener.calls)
    source.abort()  # type: ignore[attr-defined]
    await ends(stream)

    def named() -> list[object]:
        calls = pair.listener.calls[before:]
        return [params[1] for method, params in calls if method == "publisherUpdate"]

    await until(lambda: named() == ["/word"], within=20)


async def test_a_program_that_died_is_refused_as_a_dead_node_is(pair: Pair) -> None:
    site = pair.site
    site.grant("/listener", Right.GRAPH, "/talker")
    await pair.talker.register("registerPublisher", "/word", "std_msgs/String")
    ask = pair.listener.ask
    answer = await ask(pair.listener.master_uri, "lookupNode", "/talker")
    assert isinstance(answer, list)
    assert await ask(answer[2], "getPid") == [1, "", 4711]
    await pair.talker.close()
    again = await ask(pair.listener.master_uri, "lookupNode", "/talker")
    assert isinstance(again, list)
    assert again[2] == answer[2], "the number must not change"
    with pytest.raises(ConnectionRefusedError):
        await dial(*parse_uri(again[2]), 10)


async def test_a_restarted_master_hears_of_the_programs_again(pair: Pair) -> None:
    stream, source = await connect(pair)
    await pair.site.restart_master()
    update = "publisherUpdate"
    await until(lambda: any(method == update for method, _ in pair.listener.calls), within=30)
    await source.send(word("still"))  # type: ignore[attr-defined]
    assert await heard(stream, len(word("still"))) == word("still")


async def test_one_identity_for_all_and_empty_multicalls(pair: Pair) -> None:
    async with sidecar(pair.site, each=False, identity="/listener") as one:
        program = Program("/anything", one)
        assert await program.ask(one.uri, "getUri") == [1, "", one.uri]
        client = Program("/x", one)
        with pytest.raises(Fault, match="caller_id"):
            await client.ask(one.uri, "system.multicall", 1)
        await program.close()
        await client.close()
    async with sidecar(pair.site, identity="/listener") as default:
        program = Program("/not/enrolled", default)
        assert await program.ask(default.uri, "getUri") == [1, "", default.uri]
        await program.close()


async def test_a_master_that_is_away_is_no_answer(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    site.enroll("/talker")
    async with site.running(), sidecar(site) as near:
        assert site.master is not None
        await site.master.close()
        async with Program("/talker", near) as talker:
            with pytest.raises(RossecError):
                await talker.ask(talker.master_uri, "getPid")
