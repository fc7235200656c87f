"""Programs that subscribe to an alias, which a gateway of the own domain serves."""

from dataclasses import replace
from pathlib import Path

import pytest

from ca.certificates import Identity
from ca.errors import NameRefused, NotAdmitted
from rossec.channel.opening import WireProtocol
from rossec.errors import ConnectionHeaderRefused, HangUp
from rossec.participant.authorized import memory_scope
from rossec.participant.handshakes import Fields
from rossec.sidecar.core.layers import (
    Answered,
    AuthenticatePeer,
    CallPeer,
    CommandDone,
    ConnectPeer,
    HeaderArrived,
    Layer,
    ListeningAddress,
    NoAnswer,
    OpenEgress,
    PeerAuthenticated,
    PortOpened,
    UnexpectedEvent,
)
from rossec.sidecar.core.node_connections import AdmittedConnection, connect_to_peer, handle_program_call
from tests.rossec.sidecar.agent_setup import AgentSetup, run_layer
from tests.rossec.sidecar.core.handshake import ANSWER, PEER, REQUEST, no_key
from tests.support.openaccess import PROOF, OpenAccess
from tests.support.site import Site

ALIAS, SERVED, ORIGIN = "/remote/hospital/word", "/gateway/hospital/word", "/word"
API = ListeningAddress(WireProtocol.HTTP, PEER.host, PEER.port)
ASKED = ("/robot", ALIAS, [["TCPROS"]])


@pytest.fixture
def setup(tmp_path: Path) -> AgentSetup:
    return AgentSetup(Site(tmp_path / "site"))


@pytest.fixture
def access(setup: AgentSetup) -> OpenAccess:
    access = OpenAccess()
    setup.agent = replace(setup.agent, access=access)
    return access


def foreign(peer: Identity) -> Identity:
    return replace(peer, name=f"/remote/hospital{peer.name}", certified=peer.name)


def subscribed(setup: AgentSetup, topic: str = ALIAS, caller: str = "/robot") -> Fields:
    return REQUEST | {"callerid": caller.encode(), "topic": topic.encode()}


def connecting(setup: AgentSetup, fields: Fields) -> Layer[AdmittedConnection]:
    scope = memory_scope("/robot").child
    return connect_to_peer(setup.agent, PEER, fields, no_key, scope, setup.site.now())


def authenticated(peer: Identity) -> tuple[AuthenticatePeer, PeerAuthenticated]:
    return AuthenticatePeer(PEER), PeerAuthenticated(peer)


def answered(
    setup: AgentSetup, peer: Identity, wire: str, said: str = ""
) -> tuple[ConnectPeer, HeaderArrived]:
    """The header for a peer, and an answer with the topic `said`, by default the same."""
    answer = ANSWER | {"callerid": peer.certified_name.encode(), "topic": (said or wire).encode()}
    sent = ConnectPeer(PEER, subscribed(setup) | {"topic": wire.encode()} | PROOF)
    return sent, HeaderArrived(answer | PROOF, peer, setup.site.now())


@pytest.mark.parametrize("name", ["/gateway", "/gateway/ward"])
def test_a_gateway_reads_the_served_name_and_the_program_the_alias(
    setup: AgentSetup, access: OpenAccess, name: str
) -> None:
    gateway = setup.identity(name)
    admitted = run_layer(
        connecting(setup, subscribed(setup)), authenticated(gateway), answered(setup, gateway, SERVED)
    )
    assert access.presented == [("subscribe", SERVED)]
    assert access.authorized == [(name, "publish", SERVED)]
    assert admitted.answer["topic"] == ALIAS.encode()
    assert admitted.answer["callerid"] == name.encode()
    assert admitted.decision.name == SERVED


@pytest.mark.parametrize(
    ("name", "is_foreign"), [("/gateway", True), ("/gatewayx", False), ("/visitor", False)]
)
def test_whoever_is_no_gateway_here_is_asked_by_the_origins_name(
    setup: AgentSetup, access: OpenAccess, name: str, is_foreign: bool
) -> None:
    peer = setup.identity(name)
    peer = foreign(peer) if is_foreign else peer
    admitted = run_layer(
        connecting(setup, subscribed(setup)), authenticated(peer), answered(setup, peer, ORIGIN)
    )
    assert access.presented == [("subscribe", ALIAS)]
    assert access.authorized == [(peer.name, "publish", ALIAS)]
    assert admitted.answer["topic"] == ALIAS.encode()


@pytest.mark.parametrize("said", [ALIAS, ORIGIN, "/gateway/hospital/other", "/gateway/clinic/word"])
def test_a_gateway_that_answers_another_topic_is_refused(
    setup: AgentSetup, access: OpenAccess, said: str
) -> None:
    gateway = setup.identity("/gateway")
    with pytest.raises(ConnectionHeaderRefused, match=f"another topic than {SERVED}"):
        run_layer(
            connecting(setup, subscribed(setup)),
            authenticated(gateway),
            answered(setup, gateway, SERVED, said),
        )
    assert access.authorized == []


def test_a_name_of_the_own_domain_is_asked_before_the_peer_is_known(
    setup: AgentSetup, access: OpenAccess
) -> None:
    fields = subscribed(setup, SERVED)
    assert next(connecting(setup, fields)) == ConnectPeer(PEER, fields | PROOF)


def test_an_anonymous_program_has_its_own_name_towards_a_gateway(
    setup: AgentSetup, access: OpenAccess
) -> None:
    robot = replace(setup.identity("/robot"), wildcard=True)
    setup.agent = replace(setup.agent, identity=robot)
    gateway = setup.identity("/gateway")
    layer = connecting(setup, subscribed(setup, caller="/robot_1_2"))
    next(layer)
    command = layer.send(PeerAuthenticated(gateway))
    assert isinstance(command, ConnectPeer)
    assert command.fields["callerid"] == b"/robot_1_2"
    params = ("/robot_1_2", *ASKED[1:])
    call = handle_program_call(setup.agent, API, "requestTopic", params)
    next(call)
    assert call.send(PeerAuthenticated(gateway)) == CallPeer(
        API, "requestTopic", ("/robot_1_2", SERVED, [["TCPROS"]]), None
    )


def test_nothing_is_sent_where_nobody_or_no_name_is(setup: AgentSetup, access: OpenAccess) -> None:
    with pytest.raises(HangUp, match="gone"):
        run_layer(connecting(setup, subscribed(setup)), (AuthenticatePeer(PEER), NoAnswer("gone", True)))
    with pytest.raises(NameRefused, match="names no origin"):
        run_layer(connecting(setup, subscribed(setup, "/remote/hospital")))
    with pytest.raises(UnexpectedEvent):
        run_layer(connecting(setup, subscribed(setup)), (AuthenticatePeer(PEER), CommandDone()))
    with pytest.raises(HangUp, match="gone"):
        run_layer(
            handle_program_call(setup.agent, API, "requestTopic", ASKED),
            (AuthenticatePeer(API), NoAnswer("gone")),
        )
    assert access.presented == []


def test_a_gateways_topic_is_requested_by_the_served_name(setup: AgentSetup) -> None:
    gateway = setup.identity("/gateway")
    request = CallPeer(API, "requestTopic", ("/robot", SERVED, [["TCPROS"]]), None)
    answer = run_layer(
        handle_program_call(setup.agent, API, "requestTopic", ASKED),
        (AuthenticatePeer(API), PeerAuthenticated(gateway)),
        (request, Answered([1, "ready", ["TCPROS", "10.0.0.7", 6001]], gateway)),
        (OpenEgress(PEER), PortOpened(8001)),
    )
    assert answer == [1, "ready", ["TCPROS", "127.0.0.1", 8001]]


def test_real_access_has_no_served_name_of_a_label_without_a_domain(setup: AgentSetup) -> None:
    setup.site.subscribe("/robot", "/**")
    setup.agent = replace(setup.agent, access=setup.access("/robot"))
    gateway = setup.identity("/gateway")
    with pytest.raises(NotAdmitted, match="no domain is called hospital"):
        run_layer(connecting(setup, subscribed(setup)), authenticated(gateway))
