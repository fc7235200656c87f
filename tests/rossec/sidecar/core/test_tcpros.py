"""Connection headers between programs and peers."""

import dataclasses

import pytest

from grants.errors import GrantMissing
from grants.model import Restriction, Right, filter_rules
from rossec.errors import ConnectionHeaderRefused, HangUp
from rossec.participant.access import FIELD
from rossec.participant.authorized import memory_scope
from rossec.participant.delivery_options import DeliveryOptions
from rossec.participant.handshakes import Fields
from rossec.participant.message_types import message_type
from rossec.sidecar.core.layers import (
    Answered,
    CommandDone,
    ConnectPeer,
    ConnectProgram,
    Layer,
    NoAnswer,
    Suspend,
    UnexpectedEvent,
)
from rossec.sidecar.core.node_connections import AdmittedConnection, connect_to_peer
from tests.rossec.sidecar.agent_setup import AgentSetup, run_layer
from tests.rossec.sidecar.core.handshake import (
    ANSWER,
    PEER,
    REQUEST,
    REQUEST_ANSWERED,
    REQUEST_TOPIC,
    SERVICE,
    STRING,
    TOPIC_ENDPOINT,
    TOPIC_PORT,
    TOPICS_VIA_API,
    admit,
    arrived,
    no_key,
    proof,
)


@pytest.fixture
def authorized(setup: AgentSetup) -> Fields:
    setup.site.subscribe("/viewer", "/word")
    setup.site.publish("/robot", "/word")
    setup.agent = dataclasses.replace(setup.agent, access=setup.access("/robot"))
    return REQUEST | proof(setup, "/viewer", Right.SUBSCRIBE, "/word")


def test_a_subscriber_with_a_grant_is_connected_to_the_program(setup: AgentSetup, authorized: Fields) -> None:
    """The program gets no grant; the peer gets the program's; rospy omits the topic."""
    connect = ConnectProgram(TOPIC_ENDPOINT, REQUEST)
    admitted = run_layer(admit(setup, authorized), REQUEST_ANSWERED, (connect, arrived(setup, ANSWER)))
    expected = ANSWER | {"topic": b"/word"} | proof(setup, "/robot", Right.PUBLISH, "/word")
    assert admitted.answer == expected
    assert admitted.guard is None
    assert not admitted.service


def test_the_program_is_not_contacted_for_a_peer_without_grant(setup: AgentSetup) -> None:
    """N5: no byte is sent, and the refusal does not depend on whether the topic exists."""
    with pytest.raises(GrantMissing):
        run_layer(admit(setup, REQUEST))


def test_a_subscriber_with_another_caller_id_is_refused(setup: AgentSetup, authorized: Fields) -> None:
    """N6."""
    with pytest.raises(ConnectionHeaderRefused, match="calls itself"):
        run_layer(admit(setup, authorized | {"callerid": b"/robot"}))


def test_the_callerid_of_a_program_is_replaced_by_a_certified_name(
    setup: AgentSetup, authorized: Fields
) -> None:
    for given in (ANSWER | {"callerid": b"/victim"}, STRING):
        admitted = run_layer(
            admit(setup, authorized),
            REQUEST_ANSWERED,
            (ConnectProgram(TOPIC_ENDPOINT, REQUEST), arrived(setup, given)),
        )
        assert admitted.answer["callerid"] == b"/robot"


def test_an_error_of_the_program_is_passed_on(setup: AgentSetup, authorized: Fields) -> None:
    with pytest.raises(ConnectionHeaderRefused, match="no such topic"):
        run_layer(
            admit(setup, authorized),
            REQUEST_ANSWERED,
            (ConnectProgram(TOPIC_ENDPOINT, REQUEST), arrived(setup, {"error": b"no such topic"})),
        )


def test_the_port_of_an_ended_program_is_suspended(setup: AgentSetup, authorized: Fields) -> None:
    connect = ConnectProgram(TOPIC_ENDPOINT, REQUEST)
    with pytest.raises(HangUp):
        run_layer(
            admit(setup, authorized),
            REQUEST_ANSWERED,
            (connect, NoAnswer("gone", dead=True)),
            (Suspend(TOPICS_VIA_API), CommandDone()),
        )
    with pytest.raises(HangUp):
        run_layer(admit(setup, authorized), REQUEST_ANSWERED, (connect, NoAnswer("slow")))
    with pytest.raises(UnexpectedEvent):
        run_layer(admit(setup, authorized), REQUEST_ANSWERED, (connect, CommandDone()))


@pytest.mark.parametrize(
    "answer",
    [
        [0, "Not a publisher of [/word]", []],
        [-1, "no", TOPIC_PORT],
        [1, "", []],
        [True, "", TOPIC_PORT],
        [1, "", ["UDPROS", "h", 7]],
        [1, "", ["TCPROS", "h", 0]],
        [1, "", ["TCPROS", "h", 1 << 16]],
        TOPIC_PORT,
        7,
    ],
)
def test_an_unpublished_topic_is_refused(setup: AgentSetup, authorized: Fields, answer: object) -> None:
    """Only an authorized subscriber gets this refusal."""
    with pytest.raises(ConnectionHeaderRefused, match=r"^/robot does not publish /word$"):
        run_layer(admit(setup, authorized), (REQUEST_TOPIC, Answered(answer)))


def test_no_answer_to_request_topic_hangs_up(setup: AgentSetup, authorized: Fields) -> None:
    with pytest.raises(HangUp):
        run_layer(
            admit(setup, authorized),
            (REQUEST_TOPIC, NoAnswer("gone", dead=True)),
            (Suspend(TOPICS_VIA_API), CommandDone()),
        )
    with pytest.raises(HangUp):
        run_layer(admit(setup, authorized), (REQUEST_TOPIC, NoAnswer("slow")))
    with pytest.raises(UnexpectedEvent):
        run_layer(admit(setup, authorized), (REQUEST_TOPIC, CommandDone()))


def test_topics_and_services_have_separate_ports(setup: AgentSetup, authorized: Fields) -> None:
    """Independent of the rights."""
    for fields in (authorized, REQUEST):
        with pytest.raises(ConnectionHeaderRefused, match="this port is not for topics"):
            run_layer(admit(setup, fields, TOPIC_ENDPOINT))
    with pytest.raises(ConnectionHeaderRefused, match="this port is not for services"):
        run_layer(admit(setup, SERVICE))


@pytest.fixture
def restricted(setup: AgentSetup) -> Fields:
    rules = filter_rules({"data": {"clear": True}})
    setup.site.subscribe("/viewer", "/word", Restriction("std_msgs/String", (), rules))
    return REQUEST | proof(setup, "/viewer", Right.SUBSCRIBE, "/word")


def test_a_restricted_subscriber_gets_a_guard(setup: AgentSetup, restricted: Fields) -> None:
    connect = ConnectProgram(TOPIC_ENDPOINT, REQUEST)
    admitted = run_layer(admit(setup, restricted), REQUEST_ANSWERED, (connect, arrived(setup, ANSWER)))
    assert admitted.guard is not None
    pieces = admitted.guard(b"\x05\0\0\0hello", setup.site.now())
    assert pieces is not None
    assert b"".join(pieces) == b"\0\0\0\0"


def test_a_definition_that_does_not_match_its_md5sum_is_refused(
    setup: AgentSetup, restricted: Fields
) -> None:
    connect = ConnectProgram(TOPIC_ENDPOINT, REQUEST)
    answer = ANSWER | {"message_definition": b"int32 data\n"}
    with pytest.raises(ConnectionHeaderRefused, match="does not have the md5sum"):
        run_layer(admit(setup, restricted), REQUEST_ANSWERED, (connect, arrived(setup, answer)))


def test_a_definition_that_differs_from_the_known_one_is_refused(setup: AgentSetup) -> None:
    """A relay repeats definitions that may differ from the type with the same md5sum."""
    rules = filter_rules({"linear": {"clear": True}})
    setup.site.subscribe("/viewer", "/word", Restriction("geometry_msgs/Twist", (), rules))
    twist = message_type("geometry_msgs/Twist")
    answer = {
        "callerid": b"/robot",
        "type": b"geometry_msgs/Twist",
        "md5sum": twist.md5sum.encode(),
        "message_definition": twist.definition.replace("Vector3 linear", "Vector3[0] linear")
        .replace("Vector3 angular", "Vector3[2] angular")
        .encode(),
    }
    authorized = REQUEST | proof(setup, "/viewer", Right.SUBSCRIBE, "/word")
    with pytest.raises(ConnectionHeaderRefused, match="not the one this host knows"):
        run_layer(
            admit(setup, authorized),
            REQUEST_ANSWERED,
            (ConnectProgram(TOPIC_ENDPOINT, REQUEST), arrived(setup, answer)),
        )


def test_a_definition_is_not_checked_without_restrictions(setup: AgentSetup, authorized: Fields) -> None:
    answer = ANSWER | {"message_definition": b"# caf\xe9\nstring data"}
    admitted = run_layer(
        admit(setup, authorized),
        REQUEST_ANSWERED,
        (ConnectProgram(TOPIC_ENDPOINT, REQUEST), arrived(setup, answer)),
    )
    assert admitted.answer["message_definition"] == answer["message_definition"]


def test_a_program_subscribes_with_its_grants(setup: AgentSetup, authorized: Fields) -> None:
    viewer = AgentSetup(setup.site, "/viewer")
    now = setup.site.now()
    everything = REQUEST | {"type": b"*", "md5sum": b"*"}
    proven = ANSWER | {"topic": b"/word"} | proof(setup, "/robot", Right.PUBLISH, "/word")
    connect = ConnectPeer(PEER, everything | {FIELD: authorized[FIELD]})
    admitted = run_layer(
        connect_to_peer(viewer.agent, PEER, everything, no_key, memory_scope("/viewer").child, now),
        (connect, arrived(setup, proven, "/robot")),
    )
    assert admitted.answer == ANSWER | {"topic": b"/word"}
    assert admitted.guard is None
    unproven = ANSWER | {"topic": b"/word"}
    for event, error in (
        (arrived(setup, unproven, "/robot"), GrantMissing),
        (arrived(setup, proven), UnexpectedEvent),
        (NoAnswer("gone"), HangUp),
    ):
        with pytest.raises(error):
            run_layer(
                connect_to_peer(viewer.agent, PEER, everything, no_key, memory_scope("/viewer").child, now),
                (connect, event),
            )


def test_a_restricted_publisher_gets_a_guard(setup: AgentSetup, authorized: Fields) -> None:
    restriction = Restriction("std_msgs/String", ('msg.data == "go"',))
    setup.site.grant("/robot", Right.PUBLISH, "/word", restriction=restriction)
    viewer, now = AgentSetup(setup.site, "/viewer"), setup.site.now()
    proven = ANSWER | {"topic": b"/word"} | proof(setup, "/robot", Right.PUBLISH, "/word")
    connect = ConnectPeer(PEER, authorized)
    layer = connect_to_peer(viewer.agent, PEER, REQUEST, no_key, memory_scope("/viewer").child, now)
    admitted = run_layer(layer, (connect, arrived(setup, proven, "/robot")))
    assert admitted.guard is not None
    assert admitted.guard(b"\x04\0\0\0stop", now) is None
    layer = connect_to_peer(viewer.agent, PEER, REQUEST, no_key, memory_scope("/viewer").child, now)
    undefined = proven | {"message_definition": b""}
    admitted = run_layer(layer, (connect, arrived(setup, undefined, "/robot")))
    assert admitted.answer["message_definition"].strip() == b"string data"  # as this host knows it
    viewer.agent.known_types = lambda _: None
    layer = connect_to_peer(viewer.agent, PEER, REQUEST, no_key, memory_scope("/viewer").child, now)
    with pytest.raises(ConnectionHeaderRefused, match="how this subscriber reads a std_msgs/String"):
        run_layer(layer, (connect, arrived(setup, undefined, "/robot")))


OPTIONS = {"rossec_rate": b"5.000", "rossec_newest": b"1", "rossec_deflate": b"1"}


def test_the_wishes_of_a_peer_are_taken_and_the_program_gets_none(
    setup: AgentSetup, authorized: Fields
) -> None:
    """A program that answers a delivery option by itself is not believed: the peer would read other bytes."""
    connect = ConnectProgram(TOPIC_ENDPOINT, REQUEST)
    asked = {"rossec_rate": b"5.000", "rossec_newest": b"1"}
    steps = REQUEST_ANSWERED, (connect, arrived(setup, ANSWER | OPTIONS))
    admitted = run_layer(admit(setup, authorized | asked), *steps)
    assert admitted.options == DeliveryOptions(5, newest=True)
    assert {key: admitted.answer.get(key) for key in OPTIONS} == asked | {"rossec_deflate": None}
    admitted = run_layer(admit(setup, authorized), *steps)
    assert not admitted.options
    assert OPTIONS.keys().isdisjoint(admitted.answer)


def test_what_is_filtered_is_not_deflated(setup: AgentSetup) -> None:
    rules = filter_rules({"data": {"truncate": {"length": 1}}})
    setup.site.subscribe("/viewer", "/word", Restriction("std_msgs/String", (), rules))
    setup.site.publish("/robot", "/word")
    setup.agent = dataclasses.replace(setup.agent, access=setup.access("/robot"))
    asked = REQUEST | proof(setup, "/viewer", Right.SUBSCRIBE, "/word") | OPTIONS
    connect = ConnectProgram(TOPIC_ENDPOINT, REQUEST)
    admitted = run_layer(admit(setup, asked), REQUEST_ANSWERED, (connect, arrived(setup, ANSWER)))
    assert admitted.options == DeliveryOptions(5, newest=True)
    assert "rossec_deflate" not in admitted.answer


def test_a_malformed_wish_is_refused_before_the_program_is_asked(
    setup: AgentSetup, authorized: Fields
) -> None:
    with pytest.raises(ConnectionHeaderRefused, match="is no rate"):
        run_layer(admit(setup, authorized | {"rossec_rate": b"-1"}))
    with pytest.raises(GrantMissing):  # nobody without a right is told
        run_layer(admit(setup, REQUEST | {"rossec_rate": b"-1"}))


def test_a_programs_own_wishes_are_not_passed_on_and_none_may_be_answered(
    setup: AgentSetup, authorized: Fields
) -> None:
    viewer, now = AgentSetup(setup.site, "/viewer"), setup.site.now()
    requested = REQUEST | OPTIONS
    connect = ConnectPeer(PEER, authorized)
    answer = ANSWER | {"topic": b"/word"} | proof(setup, "/robot", Right.PUBLISH, "/word")

    def subscribing() -> Layer[AdmittedConnection]:
        return connect_to_peer(viewer.agent, PEER, requested, no_key, memory_scope("/viewer").child, now)

    run_layer(subscribing(), (connect, arrived(setup, answer, "/robot")))
    for key, value in OPTIONS.items():
        forged = arrived(setup, answer | {key: value}, "/robot")
        with pytest.raises(ConnectionHeaderRefused, match="asked"):
            run_layer(subscribing(), (connect, forged))
