"""A peer is authenticated before the call or header that its identity decides on."""

from collections.abc import AsyncIterator
from dataclasses import replace

import pytest

from rossec.channel.opening import WireProtocol
from rossec.errors import PeerUnreachable
from rossec.net.aio import serve
from rossec.sidecar.core.layers import (
    AuthenticatePeer,
    CallPeer,
    CommandDone,
    ConnectPeer,
    Event,
    Layer,
    NoAnswer,
    OpenIngress,
    PeerAuthenticated,
    PortOpened,
    Suspend,
)
from rossec.sidecar.executor import run_layer
from tests.rossec.sidecar.test_executor import PEER, FakeServices, PeerNode, check_answered, outcome
from tests.support.contexts import context
from tests.support.wire import BOB


@pytest.fixture
async def peer() -> AsyncIterator[PeerNode]:
    node = PeerNode()
    async with serve(node.serve_slave, "127.0.0.1", 0, context(BOB), WireProtocol.HTTP) as server:
        node.port = server.port
        yield node


async def test_a_peer_is_authenticated_on_the_connection_of_the_call(peer: PeerNode) -> None:
    def calls() -> Layer[Event]:
        known = yield AuthenticatePeer(PEER)
        assert isinstance(known, PeerAuthenticated)
        assert known.peer.name == "/bob"
        answer: Event = yield CallPeer(PEER, "requestTopic", ("/robot", "/x", []))
        return answer

    check_answered(await run_layer(peer, calls()))
    assert (peer.asked, peer.dialed, peer.checked) == (["requestTopic"], 1, ["/bob", "/bob"])


async def test_a_peer_that_cannot_be_authenticated_is_no_answer(peer: PeerNode) -> None:
    peer.refused = PeerUnreachable("its identity has expired")
    assert await outcome(peer, AuthenticatePeer(PEER)) == NoAnswer("its identity has expired")
    event = await outcome(FakeServices(), AuthenticatePeer(replace(PEER, protocol=WireProtocol.TCPROS)))
    assert isinstance(event, NoAnswer)


async def test_a_peer_out_of_reach_is_said_for_calls_and_topics() -> None:
    services = FakeServices()
    topics = replace(PEER, protocol=WireProtocol.TCPROS)
    for command in (CallPeer(PEER, "getPid", ("/robot",)), ConnectPeer(topics, {})):
        assert isinstance(await outcome(services, command), NoAnswer)
    assert [remote for remote, _ in services.unreachable] == [PEER, topics]


async def test_ingress_ports_are_opened_and_suspended() -> None:
    services = FakeServices()
    assert await outcome(services, OpenIngress(PEER)) == PortOpened(PEER.port)
    assert services.closed == []
    assert await outcome(services, Suspend(PEER)) == CommandDone()
    assert services.closed == [PEER]
