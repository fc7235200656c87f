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
from rossec.host.callers import Callers
from rossec.host.local_ports import Loopback
from rossec.net.aio.client import dial
from rossec.net.rpc.calls import RpcClient
from rossec.ros import xmlrpc
from rossec.ros.names import parse_uri, read
from rossec.ros.xmlrpc import Fault
from rossec.sidecar import server
from rossec.sidecar.loopback_port import PlainStream
from rossec.sidecar.server import Sidecar
from tests.rossec.sidecar.program import Program, sidecar
from tests.rossec.sidecar.sidecar_pair import SidecarPair
from tests.support.site import Site


async def test_a_refused_program_gets_the_reason(pair: SidecarPair) -> None:
    site = pair.site
    async with Program("/stranger", pair.listener_sidecar) as unknown:
        answer = await unknown.ask(unknown.master_uri, "getPid")
        assert isinstance(answer, list)
        assert "/stranger has no identity here (did you mean /listener? here are: " in answer[1]
        assert "for a new node: rossec node request /stranger; or use --as" in answer[1]
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
        assert "for a new node: rossec node request /rosparam --anonymous; or use --as" in str(answer)


async def test_unreadable_files_are_reported(pair: SidecarPair, monkeypatch: pytest.MonkeyPatch) -> None:
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
    writer.write(head + b"Content-Type: text/plain\r\nContent-Length: %d\r\n\r\n" % len(call) + call)
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
async def test_one_identity_serves_callers_of_any_name(pair: SidecarPair, asker: str, each: bool) -> None:
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
            ("getUri", ""),
            ("getPid", -1),
            ("getSystemState", [[], [], []]),
            ("hasParam", False),
            ("getParam", 0),
            ("registerPublisher", []),
            ("unregisterService", 0),
        ):
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
            assert (await tool.ask(running.uri, "setParam", key, 1)) == [1, f"parameter {key} set", 0]
        found = await tool.ask(running.uri, "searchParam", "speed")
        assert found == [1, "Found [/ns/speed]", "/ns/speed"]
        await tool.close()


async def test_a_namespace_that_searches_is_the_program_in_it(pair: SidecarPair) -> None:
    """roscpp's `NodeHandle::searchParam` sends its namespace, `/` or `/arm`, as the caller_id."""
    for name in ("/arm/driver", "/leg/driver"):
        pair.site.publish(name, f"{name}/state")
        pair.site.grant(name, Right.PARAM_GET | Right.PARAM_SET, f"/robot/{name[1:4]}")
        pair.site.grant(name, Right.PARAM_GET | Right.PARAM_SET, f"{name[:4]}/speed")
    async with (
        sidecar(pair.site) as running,
        Program("/arm/driver", running) as arm,
        Program("/leg/driver", running) as leg,
        Program("/arm", running) as space,
        Program("/", running) as root,
    ):
        await arm.register("registerPublisher", "/arm/driver/state", "std_msgs/String")
        assert (await arm.ask(running.uri, "setParam", "/arm/speed", 1)) == [1, "parameter /arm/speed set", 0]
        assert (await arm.ask(running.uri, "setParam", "/robot/arm", 1)) == [1, "parameter /robot/arm set", 0]
        assert (await space.ask(running.uri, "searchParam", "speed"))[2:] == ["/arm/speed"]  # type: ignore[index]
        found = await root.ask(running.uri, "searchParam", "robot/arm")
        assert found == [1, "Found [/robot/arm]", "/robot/arm"]
        await leg.register("registerPublisher", "/leg/driver/state", "std_msgs/String")
        # Two nodes below `/` in one process: the first of them, which `/proc` names.
        assert (await root.ask(running.uri, "searchParam", "robot/arm"))[0] == 1  # type: ignore[index]
        assert (await space.ask(running.uri, "searchParam", "speed"))[2:] == ["/arm/speed"]  # type: ignore[index]
        # Only the search has such a caller_id; and nobody searches from where no node is.
        assert (await space.ask(running.uri, "getParam", "/arm/speed"))[0] == -1  # type: ignore[index]
        nobody = Program("/tail", running)
        answer = await nobody.ask(running.uri, "searchParam", "speed")
        assert "/tail has no identity here" in str(answer)
        await nobody.close()


async def test_of_several_nodes_in_a_namespace_the_calling_process_searches(
    pair: SidecarPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair.site.grant("/listener", Right.PARAM_GET | Right.PARAM_SET, "/speed")
    async with (
        sidecar(pair.site) as running,
        Program("/talker", running) as talker,
        Program("/listener", running) as listener,
        Program("/", running) as root,
    ):
        await talker.register("registerPublisher", "/word", "std_msgs/String")
        await listener.register("registerSubscriber", "/word", "std_msgs/String")
        await listener.ask(running.uri, "setParam", "/speed", 1)

        async def is_listener(_callers: Callers, _sock: socket.socket, port: int) -> bool:
            return port == listener.slave.port

        monkeypatch.setattr(Callers, "is_program_at", is_listener)
        assert await root.ask(running.uri, "searchParam", "speed") == [1, "Found [/speed]", "/speed"]

        async def is_talker(_callers: Callers, _sock: socket.socket, port: int) -> bool:
            return port == talker.slave.port

        monkeypatch.setattr(Callers, "is_program_at", is_talker)
        assert "Cannot find" in str(await root.ask(running.uri, "searchParam", "speed"))


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
    settings = read(
        (), {**site.environ, "ROS_MASTER_URI": "http://[2001:db8::1]:11311"}, default_name="/sidecar"
    )
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


async def asked(pair: SidecarPair, body: bytes) -> object:
    """What a foreign client gets for a body of its own; an answer must come."""
    reader, writer = await asyncio.open_connection(*parse_uri(pair.talker_sidecar.uri))
    writer.write(b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: %d\r\n\r\n" % len(body) + body)
    async with asyncio.timeout(30):
        head = await reader.readuntil(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 200 ")
        length = re.search(rb"Content-length: (\d+)", head)
        assert length is not None
        answer = await reader.readexactly(int(length[1]))
    writer.close()
    return xmlrpc.load_response(answer)


@pytest.mark.parametrize(
    "value", ["<i8>5000000000</i8>", "<nil/>", "<array><data><value><nil/></value></data></array>"]
)
async def test_what_cannot_be_carried_is_answered_with_a_fault(pair: SidecarPair, value: str) -> None:
    """Without an answer roscpp calls again for ever."""
    pair.site.grant("/talker", Right.PARAM_SET, "/talker/**")
    values = "".join(
        f"<param><value>{each}</value></param>"
        for each in ("<string>/talker</string>", "<string>/talker/x</string>", value)
    )
    body = f"<methodCall><methodName>setParam</methodName><params>{values}</params></methodCall>"
    with pytest.raises(Fault, match="a value that XML-RPC cannot carry"):
        await asked(pair, body.encode())


async def test_an_i8_of_32_bits_is_an_integer(pair: SidecarPair) -> None:
    body = xmlrpc.dump_call("hasParam", ("/talker", "/x")).replace(b"<string>/x</string>", b"<i8>7</i8>")
    answer = await asked(pair, body)
    assert isinstance(answer, list)
    assert answer[0] == -1


async def test_a_call_that_is_too_long_is_answered_with_a_fault(pair: SidecarPair) -> None:
    body = xmlrpc.dump_call("setParam", ("/talker", "/x", "x" * xmlrpc.BODY_LIMIT))
    with pytest.raises(Fault, match="where at most 4194304 are allowed"):
        await asked(pair, body)


async def test_a_long_call_without_a_grant_is_answered_with_a_fault(pair: SidecarPair) -> None:
    """At once by the master, or for the length at which it ends the connection."""
    pair.site.enroll("/bare")
    for size in (100_000, 1_500_000):
        body = xmlrpc.dump_call("setParam", ("/bare", "/x", "x" * size))
        with pytest.raises(Fault, match=r"without a grant|shown no grant"):
            await asked(pair, body)


async def test_as_many_parameters_are_read_as_stock_gives(pair: SidecarPair) -> None:
    pair.site.grant("/talker", Right.PARAM_SET | Right.PARAM_GET, "/talker/**")
    async with Program("/talker", pair.talker_sidecar) as program:
        tree = {f"namespace{number}": {"leaf": "x" * 60, "other": number} for number in range(9000)}
        assert len(xmlrpc.dump_call("setParam", ("/talker", "/talker/tree", tree))) > 1_500_000
        answer = await program.ask(program.master_uri, "setParam", "/talker/tree", tree)
        assert isinstance(answer, list)
        assert answer[0] == 1, answer
        answer = await program.ask(program.master_uri, "getParam", "/talker/tree")
        assert isinstance(answer, list)
        assert answer[2] == tree
