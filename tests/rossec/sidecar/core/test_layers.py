"""What all layers share: names, endpoints, and commands that are answered as they must be."""

from dataclasses import replace
from pathlib import Path

import pytest

from rossec.channel.opening import WireProtocol
from rossec.errors import HangUp
from rossec.sidecar.core.layers import (
    CommandDone,
    ListeningAddress,
    NoAnswer,
    OpenEgress,
    OpenIngress,
    PeerAuthenticated,
    PortOpened,
    Program,
    UnexpectedEvent,
    authenticated_peer,
    local_endpoint,
    own_endpoint,
)
from tests.rossec.sidecar.agent_setup import HOST, AgentSetup, run_layer
from tests.support.site import Site

SLAVE = local_endpoint(WireProtocol.HTTP, 5000)
PEER = ListeningAddress(WireProtocol.HTTP, "10.0.0.7", 6000)


@pytest.fixture
def setup(tmp_path: Path) -> AgentSetup:
    return AgentSetup(Site(tmp_path / "site"), "/rviz", wildcard=True)


def test_peers_see_only_certified_names(setup: AgentSetup) -> None:
    assert setup.agent.name_for("/rviz_17") == "/rviz_17"
    assert setup.agent.name_for("/other") == "/rviz"
    assert (setup.agent.covers("/rviz_17"), setup.agent.covers("/other")) == (True, False)


def test_a_program_is_reached_at_the_port_that_was_opened(setup: AgentSetup) -> None:
    found = run_layer(setup.agent.ingress_endpoint(SLAVE), (OpenIngress(SLAVE), PortOpened(7000)))
    assert found == ListeningAddress(WireProtocol.HTTP, HOST, 7000)
    assert setup.agent.endpoints.program_at(found) == SLAVE
    with pytest.raises(UnexpectedEvent, match="no port but CommandDone"):
        run_layer(setup.agent.ingress_endpoint(SLAVE), (OpenIngress(SLAVE), CommandDone()))


def test_a_peer_is_reached_at_a_port_of_this_host(setup: AgentSetup) -> None:
    opened = (OpenEgress(PEER, probe=True), PortOpened(8000))
    uri = run_layer(setup.agent.egress_uri(PEER, probe=True), opened)
    assert uri == "http://127.0.0.1:8000/"
    assert setup.agent.endpoints.peer_at(local_endpoint(WireProtocol.HTTP, 8000)) == PEER


def test_a_program_gets_its_own_uri_as_it_wrote_it(setup: AgentSetup) -> None:
    seen = setup.agent.endpoints.add_ingress(SLAVE, 7000)
    setup.agent.endpoints.set_own_uri(SLAVE, "http://my-laptop:5000/")
    assert run_layer(setup.agent.egress_uri(seen, SLAVE)) == "http://my-laptop:5000/"
    other = local_endpoint(WireProtocol.HTTP, 5001)
    uris = setup.agent.egress_uris([seen.uri, PEER.uri], other)
    found = run_layer(uris, (OpenEgress(seen), PortOpened(8001)), (OpenEgress(PEER), PortOpened(8002)))
    assert found == ["http://127.0.0.1:8001/", "http://127.0.0.1:8002/"]


def test_what_is_no_uri_is_left_out(setup: AgentSetup) -> None:
    assert run_layer(setup.agent.egress_uris([7, "nonsense", "rosrpc://h:1"], None)) == []
    assert run_layer(setup.agent.egress_uris("http://h:1/", None)) == []
    assert own_endpoint("nonsense") is None
    assert own_endpoint("http://my-laptop:5000/") == SLAVE


def test_publishers_stay_for_their_grace_period(setup: AgentSetup) -> None:
    follow = setup.agent.followed_publishers
    assert follow("/scan", [PEER.uri, 7]) == [PEER.uri]
    setup.agent.publisher_grace.session_opened()
    assert follow("/scan", []) == [PEER.uri]
    assert follow("/other", "no list") == []
    assert follow(7, [PEER.uri]) == [PEER.uri]


def test_a_program_that_ended_is_forgotten(setup: AgentSetup) -> None:
    setup.agent.programs[SLAVE] = Program("/rviz")
    setup.agent.forget(SLAVE)
    setup.agent.forget(SLAVE)
    assert setup.agent.programs == {}


def test_a_publisher_is_listed_however_its_uri_is_written(setup: AgentSetup) -> None:
    topic = "/remote/hospital/word"
    assert not setup.agent.is_listed(topic, PEER)
    setup.agent.followed_publishers(topic, ["nonsense", "http://10.0.0.7:6000"])
    assert setup.agent.is_listed(topic, PEER)
    assert not setup.agent.is_listed(topic, replace(PEER, forwarded_port=True))
    assert not setup.agent.is_listed("/word", PEER)
    setup.agent.publisher_grace.session_opened()
    setup.agent.followed_publishers(topic, [])
    assert setup.agent.is_listed(topic, PEER), "in its grace period"
    setup.time = 60.0
    assert not setup.agent.is_listed(topic, PEER)


def test_a_foreign_peer_is_told_no_name_with_a_tail(setup: AgentSetup) -> None:
    foreign = replace(setup.identity("/rviz"), name="/remote/hospital/rviz", certified="/rviz")
    assert setup.agent.name_for_peer("/rviz_17", foreign) == "/rviz"
    assert setup.agent.name_for_peer("/rviz_17", setup.identity("/rviz")) == "/rviz_17"


def test_a_peer_is_known_once_it_is_authenticated(setup: AgentSetup) -> None:
    peer = setup.identity("/rviz")
    assert authenticated_peer(PeerAuthenticated(peer)) is peer
    with pytest.raises(HangUp, match="gone"):
        authenticated_peer(NoAnswer("gone"))
    with pytest.raises(UnexpectedEvent, match="no peer but CommandDone"):
        authenticated_peer(CommandDone())
