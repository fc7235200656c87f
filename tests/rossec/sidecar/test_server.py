"""The loopback master: the identity of each call."""

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


async def test_a_refused_program_gets_the_reason(pair: SidecarPair) -> None:
    site = pair.site
    async with Program("/stranger", pair.listener_sidecar) as unknown:
        answer = await unknown.ask(unknown.master_uri, "getPid")
        assert isinstance(answer, list)
        assert "has no identity here (enroll it: rossec node request /stranger" in answer[1]
        site.enroll("/stranger")
        await pair.talker.register("registerPublisher", "/word", "std_msgs/String")
        uris = await pair.listener.register("registerSubscriber", "/word", "std_msgs/String")
        assert isinstance(uris, list)
        # It connects to the talker directly, without the master (attack N5).
        agent = pair.listener_sidecar._agent_for("/stranger")
        remote = pair.listener_sidecar._agent_for("/listener").state.endpoints
        endpoint = next(iter(remote._egress.values()))
        answer = await unknown.ask(unknown.master_uri, "getPid")
        ingress_endpoint = f"http://127.0.0.1:{agent.open_egress(endpoint)}/"
        _, fields = await unknown.subscribe(ingress_endpoint, "/word")
        assert b"no grant" in fields["error"]
    assert not pair.talker.connections


async def test_an_anonymous_program_gets_a_hint_to_enroll(pair: SidecarPair) -> None:
    async with Program("/rosparam-4711", pair.listener_sidecar) as tool:
        answer = await tool.ask(tool.master_uri, "getPid")
        assert "rossec node request /rosparam --anonymous, or use --as" in str(answer)


async def test_unreadable_files_are_reported(
    pair: SidecarPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair.site.enroll("/odd")

    def unreadable(home: NodeHome) -> bytes:
        raise PermissionError(13, "Permission denied", str(home.path))

    monkeypatch.setattr(NodeHome, "anchor", unreadable)
    async with Program("/odd", pair.listener_sidecar) as program:
        answer = await program.ask(program.master_uri, "getPid")
        assert isinstance(answer, list)
        assert answer[0] == -1
        assert "Permission denied" in answer[1]


async def test_requests_of_web_pages_are_refused(pair: SidecarPair) -> None:
    """A browser is a program of the user, but its requests to loopback come from the page."""
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
async def test_an_enrolled_program_uses_its_own_or_the_given_identity(
    pair: SidecarPair, each: bool, expected: str
) -> None:
    async with sidecar(pair.site, each=each, identity="/listener") as running:
        assert running._agent_for("/talker").name == expected
        assert running._agent_for("/unknown").name == "/listener"


async def test_one_identity_for_all_and_empty_multicalls(pair: SidecarPair) -> None:
    async with sidecar(pair.site, each=False, identity="/listener") as running:
        program = Program("/anything", running)
        assert await program.ask(running.uri, "getUri") == [1, "", running.uri]
        client = Program("/x", running)
        with pytest.raises(Fault, match="caller_id"):
            await client.ask(running.uri, "system.multicall", 1)
        await program.close()
        await client.close()
    async with sidecar(pair.site, identity="/listener") as default:
        program = Program("/not/enrolled", default)
        assert await program.ask(default.uri, "getUri") == [1, "", default.uri]
        await program.close()


@pytest.mark.parametrize("asker", ["", "x", "/a b", "/ü", "//", "/rosparam-17", "/" + "x" * 300])
@pytest.mark.parametrize("each", [True, False])
async def test_one_identity_serves_callers_of_any_name(
    pair: SidecarPair, asker: str, each: bool
) -> None:
    async with sidecar(pair.site, each=each, identity="/listener") as running:
        program = Program(asker, running)
        assert await program.ask(running.uri, "getUri") == [1, "", running.uri]
        calls = [{"methodName": "getUri", "params": [name]} for name in ("/x", asker)]
        calls.insert(0, {"methodName": "getPid", "params": []})
        client = await bare_client(running)
        answers = await client.call("system.multicall", calls)
        missing = [[-1, "missing required caller_id parameter", -1]]
        assert answers == [missing, [[1, "", running.uri]], [[1, "", running.uri]]]
        await client.close()
        await program.close()


async def bare_client(running: Sidecar) -> RpcClient:
    """A client without caller_id."""
    return RpcClient(PlainStream(await dial(*parse_uri(running.uri), 10)), host="x")


@pytest.mark.parametrize("identity", [None, "/listener"])
async def test_calls_without_caller_id_are_answered_as_by_stock_ros(
    pair: SidecarPair, identity: str | None
) -> None:
    """Also without a default identity."""
    async with sidecar(pair.site, identity=identity) as running:
        client = await bare_client(running)
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


async def test_a_parameter_search_starts_in_the_callers_namespace(pair: SidecarPair) -> None:
    """It used to find the key of another namespace."""
    pair.site.grant("/listener", Right.PARAM_GET | Right.PARAM_SET, "/**")
    async with sidecar(pair.site, identity="/listener") as running:
        tool = Program("/ns/tool", running)
        for key in ("/speed", "/ns/speed"):
            assert (await tool.ask(running.uri, "setParam", key, 1)) == [
                1,
                f"parameter {key} set",
                0,
            ]
        found = await tool.ask(running.uri, "searchParam", "speed")
        assert found == [1, "Found [/ns/speed]", "/ns/speed"]
        await tool.close()


async def test_a_taken_port_is_reported_with_a_hint(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    settings = read((), site.environ, default_name="/sidecar")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ConfigurationError, match=r"cannot listen at 127\.0\.0\.1") as caught:
            Sidecar(site.root, settings, Callers({os.getuid()}), each=True, port=port)
    assert "choose another port" in caught.value.hint


async def test_the_master_uri_has_a_host_name_without_ipv4(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    settings = read((), {**site.environ, "ROS_MASTER_URI": "http://[2001:db8::1]:11311"},
                   default_name="/sidecar")  # fmt: skip
    callers = Callers({os.getuid()}, None, Loopback("::1", "localhost"))
    running = Sidecar(site.root, settings, callers, each=True)
    running.start()
    try:
        found = re.fullmatch(r"http://localhost:(\d+)/", running.uri)
        assert found is not None
        socket.create_connection(("::1", int(found[1]))).close()
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", int(found[1])))
    finally:
        await running.close()


async def test_the_number_of_identities_is_bounded(
    pair: SidecarPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "LIMIT", 0)
    async with sidecar(pair.site) as running:
        program = Program("/talker", running)
        answer = await program.ask(running.uri, "getPid")
        assert isinstance(answer, list)
        assert (answer[0], answer[1][:43]) == (-1, "rossec: too many identities in one sidecar ")
        await program.close()
