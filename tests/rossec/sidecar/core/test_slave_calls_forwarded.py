"""Peers behind a relay's forwarded port, and the relay's question where the topics of a program are."""

from dataclasses import replace

import pytest

from ca.certificates import Identity
from rossec.channel.opening import WireProtocol
from rossec.errors import HangUp, RossecError
from rossec.participant.slave_api import NO_TRANSPORT
from rossec.ros.names import PORTS
from rossec.sidecar.core.layers import (
    Answered,
    CallPeer,
    CommandDone,
    Layer,
    ListeningAddress,
    NoAnswer,
    OpenEgress,
    OpenIngress,
    PortOpened,
    Probe,
    Suspend,
    local_endpoint,
    topic_endpoint,
)
from rossec.sidecar.core.node_connections import handle_peer_call, handle_program_call
from tests.rossec.sidecar.agent_setup import AgentSetup, run_layer
from tests.support.openaccess import OpenAccess

SLAVE = local_endpoint(WireProtocol.HTTP, 5000)
FORWARDED_PORT = ListeningAddress(WireProtocol.HTTP, "127.0.0.1", 6000, forwarded_port=True)
PARAMS = ("/robot", "/scan", [["TCPROS"]])
REQUEST = CallPeer(FORWARDED_PORT, "requestTopic", PARAMS, None)


def asked(setup: AgentSetup, peer: Identity, *params: object) -> Layer[object]:
    return handle_peer_call(setup.agent, SLAVE, peer, PORTS, params, None, setup.site.now())


def test_behind_a_forwarded_port_the_topics_are_at_the_forwarded_port(setup: AgentSetup) -> None:
    there = Answered([1, "ready", ["TCPROS", "192.168.7.7", 41000]])
    answer = run_layer(
        handle_program_call(setup.agent, FORWARDED_PORT, "requestTopic", PARAMS),
        (REQUEST, there),
        (OpenEgress(ListeningAddress(WireProtocol.TCPROS, "127.0.0.1", 6000)), PortOpened(8001)),
    )
    assert answer == [1, "ready", ["TCPROS", "127.0.0.1", 8001]]


def test_a_peer_behind_a_forwarded_port_that_offers_no_connection_has_none(setup: AgentSetup) -> None:
    for offer in ([], ["UDPROS", b"", "h", 1, 1500], ["TCPROS", "", 1], ["TCPROS", "h", 0]):
        layer = handle_program_call(setup.agent, FORWARDED_PORT, "requestTopic", PARAMS)
        said = run_layer(layer, (REQUEST, Answered([1, "", offer])))
        assert said == [-1, NO_TRANSPORT, []]


def test_a_relay_learns_the_port_of_a_programs_topics(setup: AgentSetup) -> None:
    for name in ("/relay", "/relay/kitchen"):
        answer = run_layer(
            asked(setup, setup.identity(name), name),
            (Probe(SLAVE), CommandDone()),
            (OpenIngress(topic_endpoint(SLAVE)), PortOpened(7001)),
        )
        assert answer == [1, "", [7001]]


def test_nobody_else_learns_it(setup: AgentSetup) -> None:
    relay = setup.identity("/relay")
    foreign = replace(relay, name="/remote/hospital/relay", certified="/relay")
    for peer in (setup.identity("/viewer"), setup.identity("/master")):
        with pytest.raises(RossecError, match="for a relay alone"):
            run_layer(asked(setup, peer, peer.name))
    for params in ((), ("/viewer",), ("/relay", 1)):
        refused = run_layer(asked(setup, relay, *params))
        assert isinstance(refused, list)
        assert (refused[0], refused[2]) == (-1, [])
    setup.agent = replace(setup.agent, access=OpenAccess())  # a foreigner with every right here
    with pytest.raises(RossecError, match="for a relay alone"):
        run_layer(asked(setup, foreign, "/relay"))


def test_a_dead_program_has_no_port(setup: AgentSetup) -> None:
    with pytest.raises(HangUp):
        run_layer(
            asked(setup, setup.identity("/relay"), "/relay"),
            (Probe(SLAVE), NoAnswer("refused", dead=True)),
            (Suspend(SLAVE), CommandDone()),
        )
