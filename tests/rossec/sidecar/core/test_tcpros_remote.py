"""Connection headers between programs and nodes of other domains."""

import dataclasses

import pytest

from ca.certificates import Identity
from rossec.errors import ConnectionHeaderRefused
from rossec.participant.authorized import memory_scope
from rossec.participant.handshakes import Fields
from rossec.sidecar.core.layers import (
    AuthenticatePeer,
    ConnectPeer,
    ConnectProgram,
    HeaderArrived,
    PeerAuthenticated,
)
from rossec.sidecar.core.node_connections import admit_peer, connect_to_peer
from tests.rossec.sidecar.agent_setup import AgentSetup, run_layer
from tests.rossec.sidecar.core.handshake import (
    ANSWER,
    PEER,
    REQUEST,
    REQUEST_ANSWERED,
    REQUEST_TOPIC,
    SERVICE,
    TOPIC_ENDPOINT,
    TOPICS_VIA_API,
    admit,
    arrived,
    no_key,
)
from tests.support.openaccess import PROOF, OpenAccess

AUTHENTICATE = AuthenticatePeer(PEER)


def foreign(setup: AgentSetup, name: str) -> Identity:
    """The node of this name in the hospital's domain."""
    identity = setup.identity(name)
    return dataclasses.replace(identity, name=f"/remote/hospital{name}", certified=name)


def test_a_program_subscribes_to_an_alias_and_the_peer_reads_the_origins_name(setup: AgentSetup) -> None:
    access = OpenAccess()
    setup.agent = dataclasses.replace(setup.agent, access=access)
    robot, alias = foreign(setup, "/robot"), b"/remote/hospital/word"
    fields = REQUEST | {"callerid": b"/robot", "topic": alias}
    layer = connect_to_peer(setup.agent, PEER, fields, no_key, memory_scope("/robot").child, setup.site.now())
    connect = ConnectPeer(PEER, fields | {"topic": b"/word"} | PROOF)
    answer = HeaderArrived(ANSWER | {"topic": b"/word"} | PROOF, robot, setup.site.now())
    admitted = run_layer(layer, (AUTHENTICATE, PeerAuthenticated(robot)), (connect, answer))
    assert access.presented == [("subscribe", alias.decode())]
    assert access.authorized == [("/remote/hospital/robot", "publish", alias.decode())]
    assert admitted.answer["topic"] == alias
    assert admitted.answer["callerid"] == b"/remote/hospital/robot"
    assert admitted.guard is None


def test_a_program_calls_an_alias_and_the_peer_reads_the_origins_name(setup: AgentSetup) -> None:
    access = OpenAccess()
    setup.agent = dataclasses.replace(setup.agent, access=access)
    fields = SERVICE | {"callerid": b"/robot", "service": b"/remote/hospital/say"}
    layer = connect_to_peer(setup.agent, PEER, fields, no_key, memory_scope("/robot").child, setup.site.now())
    connect = ConnectPeer(PEER, fields | {"service": b"/say"} | PROOF)
    provider = foreign(setup, "/viewer")
    answer = HeaderArrived({"callerid": b"/viewer", "md5sum": b"7"}, provider, setup.site.now())
    admitted = run_layer(layer, (connect, answer))
    assert access.authorized == [("/remote/hospital/viewer", "provide", "/remote/hospital/say")]
    assert admitted.answer == {"callerid": b"/remote/hospital/viewer", "md5sum": b"7"}


@pytest.mark.parametrize("topic", [b"/remote/hospital/word", b"/other"])
def test_a_peer_that_answers_with_another_name_than_the_origins_is_refused(
    setup: AgentSetup, topic: bytes
) -> None:
    setup.agent = dataclasses.replace(setup.agent, access=OpenAccess())
    fields = REQUEST | {"callerid": b"/robot", "topic": b"/remote/hospital/word"}
    layer = connect_to_peer(setup.agent, PEER, fields, no_key, memory_scope("/robot").child, setup.site.now())
    connect = ConnectPeer(PEER, fields | {"topic": b"/word"} | PROOF)
    robot = foreign(setup, "/robot")
    answer = HeaderArrived(ANSWER | {"topic": topic}, robot, setup.site.now())
    with pytest.raises(ConnectionHeaderRefused, match="another topic than hospital:/word"):
        run_layer(layer, (AUTHENTICATE, PeerAuthenticated(robot)), (connect, answer))


def test_a_foreign_subscriber_is_known_to_the_program_by_its_alias(setup: AgentSetup) -> None:
    access = OpenAccess()
    setup.agent = dataclasses.replace(setup.agent, access=access)
    viewer = foreign(setup, "/viewer")
    layer = admit_peer(
        setup.agent, TOPICS_VIA_API, REQUEST, viewer, no_key, memory_scope("/robot").child, setup.site.now()
    )
    caller = {"callerid": b"/remote/hospital/viewer"}
    request = REQUEST_TOPIC._replace(params=(viewer.name, *REQUEST_TOPIC.params[1:]))
    admitted = run_layer(
        layer,
        (request, REQUEST_ANSWERED[1]),
        (ConnectProgram(TOPIC_ENDPOINT, REQUEST | caller), arrived(setup, ANSWER)),
    )
    assert access.authorized == [(viewer.name, "subscribe", "/word")]
    assert admitted.answer == ANSWER | {"topic": b"/word"} | PROOF


@pytest.mark.parametrize(
    "fields",
    [REQUEST | {"topic": b"/remote/hospital/word"}, SERVICE | {"service": b"/remote/hospital/say"}],
    ids=["topic", "service"],
)
def test_a_peer_that_asks_for_an_alias_is_refused(setup: AgentSetup, fields: Fields) -> None:
    access = OpenAccess()
    setup.agent = dataclasses.replace(setup.agent, access=access)
    local = TOPICS_VIA_API if "topic" in fields else TOPIC_ENDPOINT
    with pytest.raises(ConnectionHeaderRefused, match="no name on the wire"):
        run_layer(admit(setup, fields, local))
    assert access.authorized == []


def test_an_anonymous_program_has_its_certified_name_towards_foreigners(setup: AgentSetup) -> None:
    """They honour no tails; a peer of the own domain reads the program's name."""
    access = OpenAccess()
    robot = dataclasses.replace(setup.identity("/robot"), wildcard=True)
    setup.agent = dataclasses.replace(setup.agent, access=access, identity=robot)
    for topic, wire, caller in (
        (b"/remote/hospital/word", b"/word", b"/robot"),
        (b"/word", b"/word", b"/robot_1_2"),
    ):
        fields = REQUEST | {"callerid": b"/robot_1_2", "topic": topic}
        layer = connect_to_peer(
            setup.agent, PEER, fields, no_key, memory_scope("/robot").child, setup.site.now()
        )
        command = next(layer)
        if command == AUTHENTICATE:
            command = layer.send(PeerAuthenticated(foreign(setup, "/viewer")))
        assert command == ConnectPeer(PEER, fields | {"topic": wire, "callerid": caller} | PROOF)
        layer.close()
