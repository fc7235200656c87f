"""Network ports for programs: what peers receive, and what not."""

import asyncio
import socket

import pytest

from grants.model import Restriction, Right, filter_rules
from rossec.channel.opening import WireProtocol
from rossec.errors import RossecError
from rossec.net.aio.client import dial
from rossec.net.rpc.calls import RpcClient
from rossec.participant.access import FIELD
from rossec.participant.delivery_options import DeliveryOptions, inflated
from rossec.ros import tcpros
from rossec.ros.names import parse_uri
from rossec.sidecar.core.layers import ListeningAddress, local_endpoint
from rossec.sidecar.loopback_port import LoopbackPort
from rossec.sidecar.pump import split_header
from rossec.sidecar.server import Agent
from tests.rossec.sidecar.program import ANY_CALLER, Program, sidecar, string_message
from tests.rossec.sidecar.sidecar_pair import SidecarPair, connect, receive_bytes, wait_closed
from tests.support.witness import until

HTTP = WireProtocol.HTTP


async def test_messages_are_forwarded_unchanged(pair: SidecarPair) -> None:
    stream, source = await connect(pair)
    message = string_message("hello") + string_message("x" * 3_000_000)
    sending = asyncio.ensure_future(source.send(message))
    assert await receive_bytes(stream, len(message)) == message
    await sending
    assert b"rossec_grants" not in str(pair.talker.headers).encode()


async def test_closing_one_end_closes_the_other(pair: SidecarPair) -> None:
    stream, source = await connect(pair)
    await source.close()
    await wait_closed(stream)
    stream, source = await connect(pair)
    stream.abort()
    await wait_closed(source)


async def test_messages_for_a_restricted_subscriber_are_filtered(pair: SidecarPair) -> None:
    rules = filter_rules({"data": {"truncate": {"length": 2}}})
    for file in pair.site.enroll("/listener").path.glob("grants/*"):
        file.unlink()
    restriction = Restriction("std_msgs/String", ('msg.data != "secret"',), rules)
    pair.site.subscribe("/listener", "/word", restriction)
    stream, source = await connect(pair)
    await source.send(string_message("hello") + string_message("secret") + string_message("world"))
    expected = string_message("he") + string_message("wo")
    assert await receive_bytes(stream, len(expected)) == expected


async def test_no_message_passes_a_guard_that_raises(
    pair: SidecarPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    for file in pair.site.enroll("/listener").path.glob("grants/*"):
        file.unlink()
    rules = filter_rules({"data": {"truncate": {"length": 2}}})
    pair.site.subscribe("/listener", "/word", Restriction("std_msgs/String", (), rules))

    def crash(*_: object) -> None:
        raise ArithmeticError

    monkeypatch.setattr("grants.guard.Guard.apply", crash)
    stream, source = await connect(pair)
    await source.send(string_message("hello"))
    with pytest.raises(RossecError):
        await receive_bytes(stream, 1)
    await wait_closed(source)


async def test_service_calls_are_forwarded_both_ways(pair: SidecarPair) -> None:
    uri = f"rosrpc://127.0.0.1:{pair.talker.topics.port}"
    await pair.talker.register("registerService", "/say", uri)
    answer = await pair.listener.ask(pair.listener.master_uri, "lookupService", "/say")
    assert isinstance(answer, list)
    stream, fields = await pair.listener.call(answer[2], "/say")
    assert "error" not in fields
    for text in ("echo", "a longer one than a header" * 100_000):
        await stream.send(string_message(text))
        assert await receive_bytes(stream, len(string_message(text))) == string_message(text)


async def test_the_port_of_a_dead_program_refuses_callers(pair: SidecarPair) -> None:
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


async def ingress_endpoint(pair: SidecarPair, protocol: WireProtocol) -> tuple[Agent, ListeningAddress]:
    """The listener's agent, and the endpoint at which peers reach the talker."""
    await connect(pair)
    ports = pair.talker_sidecar._agent_for("/talker")._ingress.ports
    (port,) = (server.port for endpoint, server in ports._ports.items() if endpoint.protocol is protocol)
    return pair.listener_sidecar._agent_for("/listener"), ListeningAddress(protocol, "127.0.0.1", port)


async def test_a_subscriber_that_sends_data_is_disconnected(pair: SidecarPair) -> None:
    agent, endpoint = await ingress_endpoint(pair, WireProtocol.TCPROS)
    request = {"callerid": b"/listener", "topic": b"/word", "type": b"*", "md5sum": b"*"}
    proof = {FIELD: agent.proof(Right.SUBSCRIBE, "/word")}
    for fields, more in ((request | proof, b"more"), (request, b"")):
        stream = await agent.dial(endpoint)
        await stream.send(tcpros.encode(fields) + more)
        answer, _ = await split_header(stream)
        assert ("error" in answer) is (fields == request)
        with pytest.raises(RossecError):
            await stream.receive()


async def test_only_the_master_may_update_lists(pair: SidecarPair) -> None:
    agent, endpoint = await ingress_endpoint(pair, WireProtocol.HTTP)
    client = RpcClient(await agent.dial(endpoint))
    for method, *params in (
        ("rossec.revocationUpdate", b"list", b"timestamp"),
        ("rossec.domainsUpdate", b"list"),
        ("rossec.foreignRevocationUpdate", "hospital", b"list", b"timestamp", [b"leaf"]),
    ):
        answer = await client.call(str(method), "/master", *params)
        assert answer == [-1, f"rossec: {method} is for the master alone", 0]
    await client.close()


async def test_a_peer_with_wishes_gets_its_messages_as_it_options(pair: SidecarPair) -> None:
    agent, endpoint = await ingress_endpoint(pair, WireProtocol.TCPROS)
    fields = {"callerid": b"/listener", "topic": b"/word", "type": b"*", "md5sum": b"*"}
    options = DeliveryOptions(9000, newest=True, deflate=True)
    proof = {FIELD: agent.proof(Right.SUBSCRIBE, "/word")}
    before = len(pair.talker.connections)
    stream = await agent.dial(endpoint)
    await stream.send(tcpros.encode(fields | proof | options.fields))
    answer, rest = await split_header(stream)
    assert options.fields.items() <= answer.items()
    await until(lambda: len(pair.talker.connections) > before)
    assert b"rossec_" not in str(pair.talker.headers).encode()
    message = string_message("again " * 1000)
    await pair.talker.connections[-1].send(message)
    frames = tcpros.FrameReader()
    contents = frames.feed(rest)
    while not contents:
        contents = frames.feed(await stream.receive())
    assert inflated(contents[0], 1 << 20) == message[4:]
    stream.abort("heard enough")


async def test_a_port_that_another_program_has_now_leads_nowhere(pair: SidecarPair) -> None:
    """`/pa` was killed, `/pb` got the number of its port: a shutdown for `/pa` ended `/pb`."""
    site = pair.site
    site.publish("/pa", "/a")
    site.publish("/pb", "/b")
    async with sidecar(site) as running:
        first = Program("/pa", running)
        await first.register("registerPublisher", "/a", "std_msgs/String")
        killed = first.slave.port
        await first.close()
        second = Program("/pb", running)
        await second.slave.close()
        second.slave = LoopbackPort(ANY_CALLER, second._serve_slave, killed)
        second.slave.open()
        await second.register("registerPublisher", "/b", "std_msgs/String")
        async with Program("/pa", running) as again:
            await again.register("registerPublisher", "/a", "std_msgs/String")
            # The master asks what it knows as the old `/pa` to shut down; then it answers others.
            found = await second.ask(running.uri, "lookupNode", "/pb")
            assert isinstance(found, list)
            agents = running._agents
            old = agents["/pa"].state.endpoints.network_of(local_endpoint(HTTP, killed))
            await until(lambda: is_closed(old))
            assert [method for method, _ in second.calls if method == "shutdown"] == []
            own = agents["/pb"].state.endpoints.network_of(local_endpoint(HTTP, killed))
            assert not is_closed(own)
        await second.close()


async def test_a_reused_port_of_the_same_identity_gets_another_network_port(pair: SidecarPair) -> None:
    pair.site.enroll("/crew", wildcard=True)
    pair.site.publish("/crew", "/a")
    async with sidecar(pair.site, each=False, identity="/crew") as running:
        first = Program("/crew_1", running)
        await first.register("registerPublisher", "/a", "std_msgs/String")
        state = running._agent_for("/crew").state
        local = local_endpoint(HTTP, first.slave.port)
        old = state.endpoints.network_of(local)
        await first.close()
        async with Program("/crew_2", running) as second:
            await second.slave.close()
            second.slave = LoopbackPort(ANY_CALLER, second._serve_slave, local.port)
            second.slave.open()
            # Who takes back what has ended opens nothing, whatever listens there now.
            answer = await second.ask(running.uri, "unregisterPublisher", "/b", second.uri)
            assert isinstance(answer, list)
            assert state.endpoints.network_of(local) == old
            await second.register("registerPublisher", "/a", "std_msgs/String")
            assert state.endpoints.network_of(local) != old
            assert state.endpoints.program_at(old) is None
            assert is_closed(old)


def is_closed(endpoint: ListeningAddress) -> bool:
    """Whether the port refuses callers, as that of a dead node."""
    try:
        socket.create_connection((endpoint.host, endpoint.port), 5).close()
    except ConnectionRefusedError:
        return True
    return False
