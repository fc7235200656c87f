"""Execution of commands, and ends that do not answer."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from ca.certificates import Identity
from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.errors import PeerUnreachable
from rossec.host.local_sockets import Holder
from rossec.net.aio import SecureStream, connect, serve
from rossec.net.rpc.calls import serve_calls
from rossec.ros import tcpros
from rossec.ros.xmlrpc import Fault
from rossec.sidecar import executor as executor_module
from rossec.sidecar.core.layers import (
    Answered,
    AuthenticatePeer,
    CallMaster,
    CallPeer,
    CallProgram,
    CommandDone,
    ConnectPeer,
    ConnectProgram,
    Event,
    HeaderArrived,
    Layer,
    ListeningAddress,
    NoAnswer,
    OpenEgress,
    PeerAuthenticated,
    PortOpened,
    Probe,
    RawResponse,
    local_endpoint,
)
from rossec.sidecar.executor import CommandExecutor, SlaveApiClient, run_layer
from rossec.sidecar.pump import split_header
from tests.rossec.sidecar.program import ANY_CALLER, STRING, Program
from tests.support.contexts import context
from tests.support.ports import free_port
from tests.support.secure_streams import Stream
from tests.support.wire import ALICE, BOB
from tests.support.witness import until

PEER = ListeningAddress(WireProtocol.HTTP, "10.0.0.7", 6000)


class FakeServices:
    """The services of an agent that reaches no peer."""

    name = "/robot"
    callers = ANY_CALLER

    def __init__(self) -> None:
        self.closed: list[ListeningAddress] = []
        self.answer: Any = None
        self.taken_over: set[int] = set()
        self.unreachable: list[tuple[ListeningAddress, str]] = []

    def leads_to(self, local: ListeningAddress, listeners: list[Holder]) -> bool:
        return local.port not in self.taken_over

    def open_ingress(self, local: ListeningAddress) -> int:
        return local.port

    def suspend_ingress(self, local: ListeningAddress) -> None:
        self.closed.append(local)

    def open_egress(self, remote: ListeningAddress) -> int:
        return remote.port

    def refuse_egress(self, remote: ListeningAddress) -> int:
        self.closed.append(remote)
        return 1

    def cache_client(self, remote: ListeningAddress, client: SlaveApiClient) -> None:
        raise AssertionError(remote)

    def cached_client(self, remote: ListeningAddress) -> SlaveApiClient | None:
        return None

    async def dial(self, remote: ListeningAddress) -> SecureStream[Identity]:
        raise PeerUnreachable(f"no peer at {remote.uri}")

    def note_unreachable(self, remote: ListeningAddress, error: PeerUnreachable) -> None:
        self.unreachable.append((remote, str(error)))

    def check_peer(self, peer: Identity) -> None:
        raise AssertionError(peer)

    async def call_master(self, method: str, params: tuple[object, ...]) -> object:
        if isinstance(self.answer, Exception):
            raise self.answer
        return await self.answer()

    def proof(self, right: Right, name: str) -> bytes:
        raise AssertionError(name)


def one_command(command: Any) -> Layer[Event]:
    """A layer of one command; its outcome is the event."""
    event: Event = yield command
    return event


async def outcome(services: FakeServices, command: Any) -> Event:
    executor = CommandExecutor(services)
    try:
        return await executor.run(one_command(command))
    finally:
        await executor.close()


async def test_a_fault_is_thrown_into_the_layer() -> None:
    def multicall() -> Layer[str]:
        try:
            yield CallMaster("odd", ())
        except Fault as fault:
            return fault.faultString
        raise AssertionError("no fault")

    services = FakeServices()
    services.answer = Fault(1, "no such method")
    assert await CommandExecutor(services).run(multicall()) == "no such method"
    with pytest.raises(Fault):
        await outcome(services, CallMaster("odd", ()))


async def test_the_egress_port_of_an_unreachable_peer_refuses_callers() -> None:
    services = FakeServices()
    event = await outcome(services, CallPeer(PEER, "getPid", ("/robot",), Right.GRAPH))
    assert isinstance(event, NoAnswer)
    assert not event.dead
    assert services.closed == [PEER]
    assert await outcome(services, OpenEgress(PEER, probe=True)) == PortOpened(1)
    assert await outcome(services, OpenEgress(PEER)) == PortOpened(PEER.port)


async def test_the_egress_port_of_a_peer_behind_a_forwarded_port_hangs_up_instead() -> None:
    """A program that was refused never tries again."""
    services, forwarded_port = FakeServices(), replace(PEER, forwarded_port=True)
    event = await outcome(services, CallPeer(forwarded_port, "getPid", ("/robot",), Right.GRAPH))
    assert isinstance(event, NoAnswer)
    assert not event.dead
    assert await outcome(services, OpenEgress(forwarded_port, probe=True)) == PortOpened(PEER.port)
    assert services.closed == []


async def test_a_program_that_does_not_listen_is_dead() -> None:
    event = await outcome(FakeServices(), Probe(local_endpoint(WireProtocol.HTTP, free_port())))
    assert isinstance(event, NoAnswer)
    assert event.dead


async def test_a_master_that_does_not_answer_in_time_is_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executor_module, "DEADLINE", 0.01)
    services = FakeServices()
    services.answer = asyncio.Event().wait
    event = await outcome(services, CallMaster("getPid", ("/robot",)))
    assert event == NoAnswer("no answer in time")


async def test_another_program_at_its_port_is_not_called(program: Program) -> None:
    services = FakeServices()
    services.taken_over.add(program.slave.port)
    event = await outcome(services, Probe(local_endpoint(WireProtocol.HTTP, program.slave.port)))
    assert isinstance(event, NoAnswer)
    assert event.dead
    assert not program.calls


@pytest.fixture
async def program() -> AsyncIterator[Program]:
    sidecar: Any = SimpleNamespace(uri="")
    async with Program("/robot", sidecar) as program:
        yield program


async def test_programs_are_probed_and_called(program: Program) -> None:
    local = local_endpoint(WireProtocol.HTTP, program.slave.port)

    def calls() -> Layer[list[Event]]:
        asked = [(yield Probe(local))]
        asked.append((yield CallProgram(local, "getPid", ("/robot",))))
        return asked

    probed, parsed = await run_layer(FakeServices(), calls())
    assert (probed, parsed) == (CommandDone(), Answered([1, "", 4711]))
    assert [method for method, _ in program.calls] == ["getPid"]
    await until(lambda: program.slave.connections == 0)  # the layer has ended


async def test_headers_are_exchanged_with_a_program(program: Program) -> None:
    local = local_endpoint(WireProtocol.TCPROS, program.topics.port)
    executor = CommandExecutor(FakeServices())
    event = await executor.run(one_command(ConnectProgram(local, {"topic": b"/word"})))
    assert isinstance(event, HeaderArrived)
    assert (event.fields["type"], event.peer) == (STRING["type"], None)
    assert program.headers == [{"topic": b"/word"}]
    assert executor.program is not None
    await executor.close()


async def test_a_program_that_changed_while_connecting_is_not_used(
    program: Program, monkeypatch: pytest.MonkeyPatch
) -> None:
    def changed(*_: object) -> None:
        raise ConnectionRefusedError("another program listens there now")

    monkeypatch.setattr(type(ANY_CALLER), "check_unchanged", changed)
    event = await outcome(FakeServices(), Probe(local_endpoint(WireProtocol.HTTP, program.slave.port)))
    assert event == NoAnswer("another program listens there now", dead=True)


class PeerNode(FakeServices):
    """An agent that reaches a peer; its connections, what it is asked, and what is cached."""

    def __init__(self) -> None:
        super().__init__()
        self.port = 0
        self.asked: list[str] = []
        self.dialed = 0
        self.cached: SlaveApiClient | None = None
        self.checked: list[str] = []
        self.refused: Exception | None = None

    async def handle_call(self, method: str, params: tuple[object, ...], _: object) -> object:
        self.asked.append(method)
        return [1, "", 7]

    async def serve_slave(self, stream: Stream) -> None:
        await serve_calls(stream, self.handle_call)

    async def serve_topic(self, stream: Stream) -> None:
        fields, _ = await split_header(stream)  # type: ignore[arg-type]
        await stream.send(tcpros.encode({**fields, "type": b"x"}) + b"more")
        await stream.receive()

    async def dial(self, remote: ListeningAddress) -> Any:
        self.dialed += 1
        return await connect("127.0.0.1", self.port, context(ALICE), remote.protocol)

    def cache_client(self, remote: ListeningAddress, client: SlaveApiClient) -> None:
        self.cached = client

    def cached_client(self, remote: ListeningAddress) -> SlaveApiClient | None:
        client, self.cached = self.cached, None
        return client

    def check_peer(self, peer: Any) -> None:
        self.checked.append(peer.name)
        if self.refused is not None:
            raise self.refused

    def proof(self, right: Right, name: str) -> bytes:
        return b"grants"


@pytest.fixture
async def peer() -> AsyncIterator[PeerNode]:
    node = PeerNode()
    async with serve(node.serve_slave, "127.0.0.1", 0, context(BOB), WireProtocol.HTTP) as server:
        node.port = server.port
        yield node
        if node.cached is not None:
            await node.cached.rpc.close()


def check_answered(event: Event) -> None:
    """The peer answered, and who it is is known: the names in it may be foreign ones."""
    assert isinstance(event, Answered)
    assert (event.value, event.peer and event.peer.name) == ([1, "", 7], "/bob")


async def test_grants_are_presented_to_a_peer_once(peer: PeerNode) -> None:
    def calls() -> Layer[Event]:
        yield CallPeer(PEER, "getPid", ("/robot",), Right.GRAPH)
        answer: Event = yield CallPeer(PEER, "getPid", ("/robot",), Right.GRAPH)
        return answer

    check_answered(await run_layer(peer, calls()))
    assert peer.asked == ["rossec.presentGrants", "getPid", "getPid"]
    assert (peer.dialed, len(peer.checked)) == (1, 2)
    raw = await outcome(peer, CallPeer(PEER, "getBusStats", ("/robot",), parse=False))
    assert isinstance(raw, RawResponse)
    assert peer.asked[-1:] == ["getBusStats"]


async def test_a_peer_that_answers_a_probe_is_cached_for_the_next_caller(peer: PeerNode) -> None:
    assert await outcome(peer, OpenEgress(PEER, probe=True)) == PortOpened(PEER.port)
    assert peer.asked == ["rossec.presentGrants"]
    assert peer.closed == []
    await outcome(peer, CallPeer(PEER, "getPid", ("/robot",), Right.GRAPH))
    assert (peer.asked, peer.dialed) == (["rossec.presentGrants", "getPid"], 1)


async def test_a_cached_peer_is_checked_again_before_it_is_called(peer: PeerNode) -> None:
    await outcome(peer, OpenEgress(PEER, probe=True))
    peer.refused = PeerUnreachable("its identity has expired")
    event = await outcome(peer, CallPeer(PEER, "getPid", ("/robot",), Right.GRAPH))
    assert event == NoAnswer("its identity has expired")
    assert "getPid" not in peer.asked


async def test_a_cached_connection_that_has_ended_is_made_again(peer: PeerNode) -> None:
    await outcome(peer, OpenEgress(PEER, probe=True))
    assert peer.cached is not None
    await peer.cached.rpc.close()
    assert not peer.cached.usable
    event = await outcome(peer, CallPeer(PEER, "getPid", ("/robot",)))
    check_answered(event)
    assert peer.dialed == 2


async def test_headers_are_exchanged_with_a_peer() -> None:
    node = PeerNode()
    async with serve(node.serve_topic, "127.0.0.1", 0, context(BOB)) as server:
        node.port = server.port
        executor = CommandExecutor(node)
        remote = ListeningAddress(WireProtocol.TCPROS, "10.0.0.7", 6000)
        known = await executor.run(one_command(AuthenticatePeer(remote)))
        assert isinstance(known, PeerAuthenticated)
        event = await executor.run(one_command(ConnectPeer(remote, {"topic": b"/word"})))
        assert isinstance(event, HeaderArrived)
        assert event.fields == {"topic": b"/word", "type": b"x"}
        assert event.peer is known.peer, "the same connection"
        assert (node.dialed, executor.after_header) == (1, b"more")
        await executor.close()
