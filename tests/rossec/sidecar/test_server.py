"""The loopback master: which identity a call is made with."""

import asyncio
import os
import re
import socket
from pathlib import Path

import pytest

from grants.model import Right
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.net.aio.dial import dial
from rossec.net.rpc.client import RpcClient
from rossec.ros import xmlrpc
from rossec.ros.settings import parse_uri, read
from rossec.ros.xmlrpc import Fault
from rossec.sidecar import server
from rossec.sidecar.callers import Callers
from rossec.sidecar.core.endpoints import Loopback
from rossec.sidecar.plain_stream import PlainStream
from rossec.sidecar.server import Sidecar
from tests.rossec.sidecar.program import Program, sidecar
from tests.rossec.sidecar.sidecar_pair import SidecarPair
from tests.support.site import Site


async def test_a_program_that_may_not_is_told_why(pair: SidecarPair) -> None:
    site = pair.site
    async with Program("/stranger", pair.listener_sidecar) as stranger:
        answer = await stranger.ask(stranger.master_uri, "getPid")
        assert isinstance(answer, list)
        assert "has no identity here (enroll it: rossec node request /stranger" in answer[1]
        site.enroll("/stranger")
        await pair.talker.register("registerPublisher", "/word", "std_msgs/String")
        known = await pair.listener.register("registerSubscriber", "/word", "std_msgs/String")
        assert isinstance(known, list)
        # It knows where the talker is, and asks there without the master (attack N5).
        agent = pair.listener_sidecar._agent_for("/stranger")
        remote = pair.listener_sidecar._agent_for("/listener").state.endpoints
        place = next(iter(remote._egress.values()))
        answer = await stranger.ask(stranger.master_uri, "getPid")
        ingress_endpoint = f"http://127.0.0.1:{agent.open_egress(place)}/"
        _, fields = await stranger.subscribe(ingress_endpoint, "/word")
        assert b"no grant" in fields["error"]
    assert not pair.talker.connections


async def test_an_anonymous_program_is_told_how_to_enroll(pair: SidecarPair) -> None:
    async with Program("/rosparam-4711", pair.listener_sidecar) as tool:
        answer = await tool.ask(tool.master_uri, "getPid")
        assert "rossec node request /rosparam --anonymous, or use --as" in str(answer)


async def test_files_that_cannot_be_read_are_named(
    pair: SidecarPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair.site.enroll("/odd")

    def unreadable(home: NodeHome) -> bytes:
        raise PermissionError(13, "Permission denied", str(home.path))

    monkeypatch.setattr(NodeHome, "anchor", unreadable)
    async with Program("/odd", pair.listener_sidecar) as odd:
        answer = await odd.ask(odd.master_uri, "getPid")
        assert isinstance(answer, list)
        assert answer[0] == -1
        assert "Permission denied" in answer[1]


async def test_a_web_page_speaks_for_nobody(pair: SidecarPair) -> None:
    """A browser is a program of the user; what it sends to a port of loopback is the page's."""
    reader, writer = await asyncio.open_connection(*parse_uri(pair.talker_sidecar.uri))
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
    pair: SidecarPair, each: bool, expected: str
) -> None:
    async with sidecar(pair.site, each=each, identity="/listener") as one:
        assert one._agent_for("/talker").name == expected
        assert one._agent_for("/unknown").name == "/listener"


async def test_one_identity_for_all_and_empty_multicalls(pair: SidecarPair) -> None:
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


@pytest.mark.parametrize("asker", ["", "x", "/a b", "/ü", "//", "/rosparam-17", "/" + "x" * 300])
@pytest.mark.parametrize("each", [True, False])
async def test_one_identity_serves_whatever_name_asks(
    pair: SidecarPair, asker: str, each: bool
) -> None:
    async with sidecar(pair.site, each=each, identity="/listener") as one:
        program = Program(asker, one)
        assert await program.ask(one.uri, "getUri") == [1, "", one.uri]
        calls = [{"methodName": "getUri", "params": [name]} for name in ("/x", asker)]
        calls.insert(0, {"methodName": "getPid", "params": []})
        client = await bare(one)
        answers = await client.call("system.multicall", calls)
        missing = [[-1, "missing required caller_id parameter", -1]]
        assert answers == [missing, [[1, "", one.uri]], [[1, "", one.uri]]]
        await client.close()
        await program.close()


async def bare(one: Sidecar) -> RpcClient:
    """A client that says nothing of itself."""
    return RpcClient(PlainStream(await dial(*parse_uri(one.uri), 10)), host="x")


@pytest.mark.parametrize("identity", [None, "/listener"])
async def test_a_call_without_arguments_is_answered_as_stock_does(
    pair: SidecarPair, identity: str | None
) -> None:
    """Also where no identity could be meant."""
    async with sidecar(pair.site, identity=identity) as one:
        client = await bare(one)
        for method, default in (
            ("getUri", ""), ("getPid", -1), ("getSystemState", [[], [], []]), ("hasParam", False),
            ("getParam", 0), ("registerPublisher", []), ("unregisterService", 0),
        ):  # fmt: skip
            answer = await client.call(method)
            assert answer == [-1, "missing required caller_id parameter", default], method
            assert await client.call(method, 7) == [-1, "caller_id must be a string", default]
        with pytest.raises(Fault, match="is not supported"):
            await client.call("system.listMethods")
        await client.close()


async def test_a_search_finds_what_is_nearest_to_the_asker(pair: SidecarPair) -> None:
    """It found the key of another namespace, without a word."""
    pair.site.grant("/listener", Right.PARAM_GET | Right.PARAM_SET, "/**")
    async with sidecar(pair.site, identity="/listener") as one:
        tool = Program("/ns/tool", one)
        for key in ("/speed", "/ns/speed"):
            assert (await tool.ask(one.uri, "setParam", key, 1)) == [1, f"parameter {key} set", 0]
        found = await tool.ask(one.uri, "searchParam", "speed")
        assert found == [1, "Found [/ns/speed]", "/ns/speed"]
        await tool.close()


async def test_where_it_cannot_listen_it_says_what_is_missing(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    settings = read((), site.environ, default_name="/sidecar")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ConfigurationError, match=r"cannot listen at 127\.0\.0\.1") as caught:
            Sidecar(site.root, settings, Callers({os.getuid()}), each=True, port=port)
    assert "choose another port" in caught.value.hint


async def test_on_a_host_without_ipv4_it_goes_by_name(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    settings = read((), {**site.environ, "ROS_MASTER_URI": "http://[2001:db8::1]:11311"},
                   default_name="/sidecar")  # fmt: skip
    callers = Callers({os.getuid()}, None, Loopback("::1", "localhost"))
    one = Sidecar(site.root, settings, callers, each=True)
    one.start()
    try:
        found = re.fullmatch(r"http://localhost:(\d+)/", one.uri)
        assert found is not None
        socket.create_connection(("::1", int(found[1]))).close()
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", int(found[1])))
    finally:
        await one.close()


async def test_identities_in_use_are_bounded(
    pair: SidecarPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "_LIMIT", 0)
    async with sidecar(pair.site) as one:
        program = Program("/talker", one)
        answer = await program.ask(one.uri, "getPid")
        assert isinstance(answer, list)
        assert (answer[0], answer[1][:43]) == (-1, "rossec: too many identities in one sidecar ")
        await program.close()
