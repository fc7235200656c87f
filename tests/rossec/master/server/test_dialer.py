"""The peer at a slave API must be the node that registered it."""

import asyncio
import socket
from dataclasses import replace

import pytest

from rossec.errors import AnswerRefused
from rossec.master.server.updates import is_node
from rossec.master.state.registry import NodeRef
from tests.rossec.master.world import EVERYTHING, SlaveNode, T, World, until
from tests.support.authority import Site


async def test_the_peer_must_be_the_registered_node(world: World) -> None:
    """Attack M8: the master sends updates of a node to no other peer."""
    liar, victim = await world.node("/liar"), await world.node("/victim")
    await liar.ask("registerSubscriber", "/t", T, victim.uri)
    await victim.ask("registerPublisher", "/t", T, "http://127.0.0.1:9/")
    other = await world.node("/other")
    await other.ask("registerSubscriber", "/t", T, other.uri)
    await other.ask("registerPublisher", "/t", T, other.uri)
    await until(lambda: other.received_calls("publisherUpdate") != [])
    assert victim.received == []


async def test_a_node_that_registers_the_address_of_another_is_removed(
    world: World, caplog: pytest.LogCaptureFixture
) -> None:
    squatter, victim = await world.node("/squatter"), await world.node("/victim")
    viewer = await world.node("/viewer")
    await viewer.ask("registerSubscriber", "/t", T, viewer.uri)
    await squatter.ask("registerPublisher", "/t", T, victim.uri)
    await squatter.ask("registerSubscriber", "/t", T, victim.uri)
    await viewer.ask("registerPublisher", "/t", T, viewer.uri)  # of which the squatter is notified
    await until(lambda: viewer.received_calls("publisherUpdate")[-1:] == [("/t", [viewer.uri])])
    assert f"/squatter is removed: /victim answers at {victim.uri}" in caplog.text
    assert world.server.effects.updates.nodes == (NodeRef("/viewer", viewer.uri, viewer.member.thumbprint),)
    assert await victim.ask("registerPublisher", "/t", T, victim.uri) == [viewer.uri]
    assert victim.received == []


async def test_a_node_at_the_port_of_a_dead_one_can_register(
    world: World, caplog: pytest.LogCaptureFixture
) -> None:
    """The address is registered by another node, but the peer there proves its own key."""
    gone, heir = await world.node("/gone"), await world.node("/heir")
    await gone.ask("registerPublisher", "/t", T, heir.uri)
    assert await heir.ask("registerSubscriber", "/t", T, heir.uri) == []
    assert f"/gone is removed: /heir answers at {heir.uri}" in caplog.text
    assert "/heir may not" not in caplog.text
    eve = await world.node("/eve")
    with pytest.raises(AnswerRefused, match="registered by another node"):
        await eve.ask("registerSubscriber", "/t", T, heir.uri)
    assert caplog.text.count("/eve may not registerSubscriber") == 1
    assert await eve.ask("lookupNode", "/heir") == heir.uri


async def test_a_node_is_probed_once_at_a_time(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rossec.master.server.updates.CALL_DEADLINE", 0.5)
    loop = asyncio.get_running_loop()
    with socket.create_server(("127.0.0.1", 0)) as silent:
        silent.setblocking(False)
        uri = f"http://127.0.0.1:{silent.getsockname()[1]}/"
        slow, eve, bob = [await world.node(name) for name in ("/slow", "/eve", "/bob")]
        await slow.ask("registerPublisher", "/t", T, uri)
        pending = asyncio.ensure_future(eve.ask("registerPublisher", "/t", T, uri))
        connected, _ = await loop.sock_accept(silent)
        with connected:
            with pytest.raises(AnswerRefused, match="registered by another node"):
                await bob.ask("registerPublisher", "/t", T, uri)
            assert not pending.done()
            with pytest.raises(AnswerRefused, match="registered by another node"):
                await pending
        assert world.server.effects.dialer.probed == set()
        assert await bob.ask("lookupNode", "/slow") == uri


async def test_an_update_for_one_key_is_not_sent_to_another_of_the_same_name(world: World) -> None:
    node, other = await world.node("/node"), await world.node("/other")
    newer = SlaveNode(world, world.site.enroll("/node"))
    await newer.start(EVERYTHING)
    await node.ask("registerSubscriber", "/t", T, newer.uri)
    await other.ask("registerSubscriber", "/t", T, other.uri)
    await other.ask("registerPublisher", "/t", T, other.uri)
    await until(lambda: other.received_calls("publisherUpdate") != [])
    assert newer.received == []


@pytest.mark.parametrize(
    ("registered", "key", "expected"),
    [
        ("/remote/hospital/rounds/robot3", b"k" * 32, True),
        ("/rounds/robot3", b"k" * 32, False),
        ("/remote/clinic/rounds/robot3", b"k" * 32, False),
        ("/remote/hospital/rounds/robot3", b"o" * 32, False),
    ],
)
def test_a_foreigner_is_the_node_of_its_alias(registered: str, key: bytes, expected: bool) -> None:
    """Its certified name is that of another node, were it one of ours."""
    own = Site().enroll("/rounds/robot3").identity
    alias = "/remote/hospital/rounds/robot3"
    found = replace(own, name=alias, certified=own.name, thumbprint=b"k" * 32)
    assert is_node(found, NodeRef(registered, "http://10.0.0.9:1/", key)) == expected
    assert is_node(own, NodeRef(own.name, "http://10.0.0.9:1/", own.thumbprint))
