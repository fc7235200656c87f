"""How commands are carried out, and what becomes of an end that does not answer."""

import asyncio
from typing import Any

import pytest

from ca.certificates import Identity
from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.errors import PeerUnreachable
from rossec.net.aio import SecureStream
from rossec.ros.xmlrpc import Fault
from rossec.sidecar import executor as visits
from rossec.sidecar.core.commands import AskMaster, AskRemote, OpenEgress, Probe
from rossec.sidecar.core.endpoints import Endpoint, inside
from rossec.sidecar.core.events import Event, NoAnswer, Opened
from rossec.sidecar.core.layers import Layer
from rossec.sidecar.executor import CommandExecutor, SlaveApiClient
from rossec.sidecar.loopback_port import free_port
from tests.rossec.sidecar.program import ANYBODY

PEER = Endpoint(WireProtocol.HTTP, "10.0.0.7", 6000)


class House:
    """An identity that reaches nobody."""

    name = "/robot"
    callers = ANYBODY

    def __init__(self) -> None:
        self.closed: list[Endpoint] = []
        self.answer: Any = None

    def export(self, local: Endpoint) -> int:
        return local.port

    def rest(self, local: Endpoint) -> None:
        self.closed.append(local)

    def bring(self, remote: Endpoint) -> int:
        return remote.port

    def shut(self, remote: Endpoint) -> int:
        self.closed.append(remote)
        return 1

    def keep(self, remote: Endpoint, correspondent: SlaveApiClient) -> None:
        raise AssertionError(remote)

    def kept(self, remote: Endpoint) -> SlaveApiClient | None:
        return None

    async def dial(self, remote: Endpoint) -> SecureStream[Identity]:
        raise PeerUnreachable(f"nobody at {remote.uri}")

    def check(self, peer: Identity) -> None:
        raise AssertionError(peer)

    async def ask_master(self, method: str, params: tuple[object, ...]) -> object:
        if isinstance(self.answer, Exception):
            raise self.answer
        return await self.answer()

    def proof(self, right: Right, name: str) -> bytes:
        raise AssertionError(name)


def asking(command: Any) -> Layer[Event]:
    """A layer of one question; its outcome is the event."""
    event: Event = yield command
    return event


async def outcome(house: House, command: Any) -> Event:
    visit = CommandExecutor(house)
    try:
        return await visit.run(asking(command))
    finally:
        await visit.close()


async def test_a_fault_is_given_to_the_layer() -> None:
    def multicall() -> Layer[str]:
        try:
            yield AskMaster("odd", ())
        except Fault as fault:
            return fault.faultString
        raise AssertionError("no fault")

    house = House()
    house.answer = Fault(1, "no such method")
    assert await CommandExecutor(house).run(multicall()) == "no such method"
    with pytest.raises(Fault):
        await outcome(house, AskMaster("odd", ()))


async def test_a_peer_out_of_reach_has_its_door_shut() -> None:
    house = House()
    event = await outcome(house, AskRemote(PEER, "getPid", ("/robot",), Right.GRAPH))
    assert isinstance(event, NoAnswer)
    assert not event.dead
    assert house.closed == [PEER]
    assert await outcome(house, OpenEgress(PEER, probe=True)) == Opened(1)
    assert await outcome(house, OpenEgress(PEER)) == Opened(PEER.port)


async def test_a_program_that_does_not_listen_is_dead() -> None:
    event = await outcome(House(), Probe(inside(WireProtocol.HTTP, free_port())))
    assert isinstance(event, NoAnswer)
    assert event.dead


async def test_who_does_not_answer_in_time_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(visits, "DEADLINE", 0.01)
    house = House()
    house.answer = asyncio.Event().wait
    event = await outcome(house, AskMaster("getPid", ("/robot",)))
    assert event == NoAnswer("no answer in time")
