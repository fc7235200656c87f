"""Execution of commands, and ends that do not answer."""

import asyncio
from typing import Any

import pytest

from ca.certificates import Identity
from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.errors import PeerUnreachable
from rossec.net.aio import SecureStream
from rossec.ros.xmlrpc import Fault
from rossec.sidecar import executor as executor_module
from rossec.sidecar.core.commands import CallMaster, CallPeer, OpenEgress, Probe
from rossec.sidecar.core.endpoints import Endpoint, local_endpoint
from rossec.sidecar.core.events import Event, NoAnswer, Opened
from rossec.sidecar.core.layers import Layer
from rossec.sidecar.executor import CommandExecutor, SlaveApiClient
from rossec.sidecar.loopback_port import free_port
from tests.rossec.sidecar.program import ANY_CALLER

PEER = Endpoint(WireProtocol.HTTP, "10.0.0.7", 6000)


class FakeServices:
    """The services of an agent that reaches no peer."""

    name = "/robot"
    callers = ANY_CALLER

    def __init__(self) -> None:
        self.closed: list[Endpoint] = []
        self.answer: Any = None

    def open_ingress(self, local: Endpoint) -> int:
        return local.port

    def suspend_ingress(self, local: Endpoint) -> None:
        self.closed.append(local)

    def open_egress(self, remote: Endpoint) -> int:
        return remote.port

    def refuse_egress(self, remote: Endpoint) -> int:
        self.closed.append(remote)
        return 1

    def cache_client(self, remote: Endpoint, client: SlaveApiClient) -> None:
        raise AssertionError(remote)

    def cached_client(self, remote: Endpoint) -> SlaveApiClient | None:
        return None

    async def dial(self, remote: Endpoint) -> SecureStream[Identity]:
        raise PeerUnreachable(f"no peer at {remote.uri}")

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
    assert await outcome(services, OpenEgress(PEER, probe=True)) == Opened(1)
    assert await outcome(services, OpenEgress(PEER)) == Opened(PEER.port)


async def test_a_program_that_does_not_listen_is_dead() -> None:
    event = await outcome(FakeServices(), Probe(local_endpoint(WireProtocol.HTTP, free_port())))
    assert isinstance(event, NoAnswer)
    assert event.dead


async def test_a_master_that_does_not_answer_in_time_is_no_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(executor_module, "DEADLINE", 0.01)
    services = FakeServices()
    services.answer = asyncio.Event().wait
    event = await outcome(services, CallMaster("getPid", ("/robot",)))
    assert event == NoAnswer("no answer in time")
