"""The loopback master: which identity a call is made with."""

import asyncio

import pytest

from rossec.home import NodeHome
from rossec.ros import xmlrpc
from rossec.ros.settings import parse_uri
from rossec.ros.xmlrpc import Fault
from rossec.sidecar import server
from tests.rossec.sidecar.conversation import Pair
from tests.rossec.sidecar.program import Program, sidecar


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


async def test_an_anonymous_program_is_told_how_to_enroll(pair: Pair) -> None:
    async with Program("/rosparam-4711", pair.far) as tool:
        answer = await tool.ask(tool.master_uri, "getPid")
        assert "rossec node request /rosparam --anonymous, or use --as" in str(answer)


async def test_files_that_cannot_be_read_are_named(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair.site.enroll("/odd")

    def unreadable(home: NodeHome) -> bytes:
        raise PermissionError(13, "Permission denied", str(home.path))

    monkeypatch.setattr(NodeHome, "anchor", unreadable)
    async with Program("/odd", pair.far) as odd:
        answer = await odd.ask(odd.master_uri, "getPid")
        assert isinstance(answer, list)
        assert answer[0] == -1
        assert "Permission denied" in answer[1]


async def test_a_web_page_speaks_for_nobody(pair: Pair) -> None:
    """A browser is a program of the user; what it sends to a port of loopback is the page's."""
    reader, writer = await asyncio.open_connection(*parse_uri(pair.near.uri))
    call = xmlrpc.dump_call("setParam", ("/talker", "/x", 1))
    head = b"POST / HTTP/1.1\r\nHost: localhost\r\nOrigin: https://evil.example\r\n"
    writer.write(
        head + b"Content-Type: text/plain\r\nContent-Length: %d\r\n\r\n" % len(call) + call
    )
    assert (await reader.read()).startswith(b"HTTP/1.1 403 ")
    writer.close()
    await writer.wait_closed()


@pytest.mark.parametrize(("each", "expected"), [(True, "/talker"), (False, "/listener")])
async def test_whose_identity_an_enrolled_program_uses(
    pair: Pair, each: bool, expected: str
) -> None:
    async with sidecar(pair.site, each=each, identity="/listener") as one:
        assert one._agent_for("/talker").name == expected
        assert one._agent_for("/unknown").name == "/listener"


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


async def test_identities_in_use_are_bounded(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "_LIMIT", 0)
    async with sidecar(pair.site) as one:
        program = Program("/talker", one)
        answer = await program.ask(one.uri, "getPid")
        assert isinstance(answer, list)
        assert (answer[0], answer[1][:43]) == (-1, "rossec: too many identities in one sidecar ")
        await program.close()
