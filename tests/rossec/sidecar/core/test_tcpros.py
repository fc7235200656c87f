"""Connection headers between programs and peers."""

import dataclasses

import pytest

from grants.errors import GrantMissing, RestrictionMismatch
from grants.model import Restriction, Right, filter_rules
from rossec.channel.opening import WireProtocol
from rossec.errors import CallerMismatch, ConnectionHeaderRefused, HangUp
from rossec.participant.access import FIELD
from rossec.participant.header_fields import Fields
from rossec.participant.limit_memory import memory_scope
from rossec.participant.message_types import message_type
from rossec.sidecar.core.commands import CallProgram, Command, ConnectPeer, ConnectProgram, Suspend
from rossec.sidecar.core.endpoints import Endpoint, local_endpoint, topic_endpoint
from rossec.sidecar.core.events import Answered, CommandDone, Event, HeaderArrived, NoAnswer
from rossec.sidecar.core.layers import Layer, UnexpectedEvent
from rossec.sidecar.core.tcpros import AdmittedConnection, admit_peer, connect_to_peer
from tests.rossec.sidecar.agent_setup import AgentSetup, run_layer

SLAVE = local_endpoint(WireProtocol.HTTP, 5000)
DOOR = topic_endpoint(SLAVE)
PLACE = ["TCPROS", "localhost", 5001]
TOPICS = local_endpoint(WireProtocol.TCPROS, 5001)
PEER = Endpoint(WireProtocol.TCPROS, "10.0.0.7", 6001)
STRING = {"type": b"std_msgs/String", "md5sum": b"992ce8a1687cec8c8bd883ec73ca41d1"}
ASKED = {"callerid": b"/viewer", "topic": b"/word", "tcp_nodelay": b"1", **STRING}
ANSWER = {"callerid": b"/robot", "message_definition": b"string data\n", "latching": b"0", **STRING}
SERVICE = {"callerid": b"/viewer", "service": b"/say", "md5sum": b"*"}


def no_key(name: str) -> bytes:
    raise AssertionError(name)


def proof(setup: AgentSetup, name: str, right: Right, topic: str) -> Fields:
    return {FIELD: setup.access(name).present(right, topic, setup.site.now())}


def admit(setup: AgentSetup, fields: Fields, door: Endpoint = DOOR) -> Layer[AdmittedConnection]:
    peer = setup.identity("/viewer")
    return admit_peer(
        setup.agent, door, fields, peer, no_key, memory_scope("/robot").child, setup.site.now()
    )


ASK = CallProgram(SLAVE, "requestTopic", ("/viewer", "/word", [["TCPROS"]]))
WHERE: tuple[Command, Event] = (ASK, Answered([1, "ready", PLACE]))
"""A program is asked where its topic is, and says so."""


def arrived(setup: AgentSetup, fields: Fields, peer: str | None = None) -> HeaderArrived:
    who = None if peer is None else setup.identity(peer)
    return HeaderArrived(fields, who, setup.site.now())


@pytest.fixture
def shown(setup: AgentSetup) -> Fields:
    setup.site.subscribe("/viewer", "/word")
    setup.site.publish("/robot", "/word")
    setup.agent = dataclasses.replace(setup.agent, access=setup.access("/robot"))
    return ASKED | proof(setup, "/viewer", Right.SUBSCRIBE, "/word")


def test_a_subscriber_with_a_grant_meets_the_program(setup: AgentSetup, shown: Fields) -> None:
    """The program sees no grant; the peer sees the program's; rospy leaves out the topic."""
    meet = ConnectProgram(TOPICS, ASKED)
    admitted = run_layer(admit(setup, shown), WHERE, (meet, arrived(setup, ANSWER)))
    expected = ANSWER | {"topic": b"/word"} | proof(setup, "/robot", Right.PUBLISH, "/word")
    assert admitted.answer == expected
    assert admitted.guard is None
    assert not admitted.service


def test_without_a_grant_the_program_does_not_hear_of_it(setup: AgentSetup) -> None:
    """N5: not a byte, and no hint whether the topic exists."""
    with pytest.raises(GrantMissing):
        run_layer(admit(setup, ASKED))


def test_a_subscriber_may_not_lie_about_its_name(setup: AgentSetup, shown: Fields) -> None:
    """N6."""
    with pytest.raises(CallerMismatch):
        run_layer(admit(setup, shown | {"callerid": b"/robot"}))


def test_the_programs_own_name_is_never_taken_on_trust(setup: AgentSetup, shown: Fields) -> None:
    for given in (ANSWER | {"callerid": b"/victim"}, STRING):
        admitted = run_layer(
            admit(setup, shown), WHERE, (ConnectProgram(TOPICS, ASKED), arrived(setup, given))
        )
        assert admitted.answer["callerid"] == b"/robot"


def test_what_the_program_refuses_is_passed_on(setup: AgentSetup, shown: Fields) -> None:
    with pytest.raises(ConnectionHeaderRefused, match="no such topic"):
        run_layer(
            admit(setup, shown),
            WHERE,
            (ConnectProgram(TOPICS, ASKED), arrived(setup, {"error": b"no such topic"})),
        )


def test_a_program_that_is_gone_closes_its_door(setup: AgentSetup, shown: Fields) -> None:
    meet = ConnectProgram(TOPICS, ASKED)
    with pytest.raises(HangUp):
        run_layer(
            admit(setup, shown),
            WHERE,
            (meet, NoAnswer("gone", dead=True)),
            (Suspend(DOOR), CommandDone()),
        )
    with pytest.raises(HangUp):
        run_layer(admit(setup, shown), WHERE, (meet, NoAnswer("slow")))
    with pytest.raises(UnexpectedEvent):
        run_layer(admit(setup, shown), WHERE, (meet, CommandDone()))


@pytest.mark.parametrize(
    "answer",
    [
        [0, "Not a publisher of [/word]", []], [-1, "no", PLACE], [1, "", []], [True, "", PLACE],
        [1, "", ["UDPROS", "h", 7]], [1, "", ["TCPROS", "h", 0]], [1, "", ["TCPROS", "h", 1 << 16]],
        PLACE, 7,
    ],
)  # fmt: skip
def test_what_the_program_does_not_publish(
    setup: AgentSetup, shown: Fields, answer: object
) -> None:
    """Only who may subscribe hears of it."""
    with pytest.raises(ConnectionHeaderRefused, match=r"^/robot does not publish /word$"):
        run_layer(admit(setup, shown), (ASK, Answered(answer)))


def test_a_program_that_cannot_be_asked(setup: AgentSetup, shown: Fields) -> None:
    with pytest.raises(HangUp):
        run_layer(
            admit(setup, shown), (ASK, NoAnswer("gone", dead=True)), (Suspend(DOOR), CommandDone())
        )
    with pytest.raises(HangUp):
        run_layer(admit(setup, shown), (ASK, NoAnswer("slow")))
    with pytest.raises(UnexpectedEvent):
        run_layer(admit(setup, shown), (ASK, CommandDone()))


def test_topics_and_services_have_doors_of_their_own(setup: AgentSetup, shown: Fields) -> None:
    """Whatever the right."""
    for fields in (shown, ASKED):
        with pytest.raises(ConnectionHeaderRefused, match="this port is not for topics"):
            run_layer(admit(setup, fields, TOPICS))
    with pytest.raises(ConnectionHeaderRefused, match="this port is not for services"):
        run_layer(admit(setup, SERVICE))


@pytest.fixture
def restricted(setup: AgentSetup) -> Fields:
    rules = filter_rules({"data": {"clear": True}})
    setup.site.subscribe("/viewer", "/word", Restriction("std_msgs/String", (), rules))
    return ASKED | proof(setup, "/viewer", Right.SUBSCRIBE, "/word")


def test_a_restricted_subscriber_gets_a_guard(setup: AgentSetup, restricted: Fields) -> None:
    meet = ConnectProgram(TOPICS, ASKED)
    admitted = run_layer(admit(setup, restricted), WHERE, (meet, arrived(setup, ANSWER)))
    assert admitted.guard is not None
    pieces = admitted.guard(b"\x05\0\0\0hello", setup.site.now())
    assert pieces is not None
    assert b"".join(pieces) == b"\0\0\0\0"


def test_a_definition_that_cannot_be_proved_is_refused(
    setup: AgentSetup, restricted: Fields
) -> None:
    meet = ConnectProgram(TOPICS, ASKED)
    answer = ANSWER | {"message_definition": b"int32 data\n"}
    with pytest.raises(ConnectionHeaderRefused, match="does not have the md5sum"):
        run_layer(admit(setup, restricted), WHERE, (meet, arrived(setup, answer)))


def test_what_a_relay_repeats_is_not_taken_on_trust(setup: AgentSetup) -> None:
    """Its own publisher may have described the type otherwise, under the same md5sum."""
    rules = filter_rules({"linear": {"clear": True}})
    setup.site.subscribe("/viewer", "/word", Restriction("geometry_msgs/Twist", (), rules))
    twist = message_type("geometry_msgs/Twist")
    said = {
        "callerid": b"/robot", "type": b"geometry_msgs/Twist", "md5sum": twist.md5sum.encode(),
        "message_definition": twist.definition.replace("Vector3 linear", "Vector3[0] linear")
        .replace("Vector3 angular", "Vector3[2] angular").encode(),
    }  # fmt: skip
    shown = ASKED | proof(setup, "/viewer", Right.SUBSCRIBE, "/word")
    with pytest.raises(ConnectionHeaderRefused, match="not the one this host knows"):
        run_layer(admit(setup, shown), WHERE, (ConnectProgram(TOPICS, ASKED), arrived(setup, said)))


def test_a_definition_that_nobody_looks_at_may_be_anything(
    setup: AgentSetup, shown: Fields
) -> None:
    said = ANSWER | {"message_definition": b"# caf\xe9\nstring data"}
    admitted = run_layer(
        admit(setup, shown), WHERE, (ConnectProgram(TOPICS, ASKED), arrived(setup, said))
    )
    assert admitted.answer["message_definition"] == said["message_definition"]


def test_services_both_ways(setup: AgentSetup) -> None:
    setup.site.grant("/viewer", Right.CALL, "/say")
    setup.site.grant("/robot", Right.PROVIDE, "/say")
    setup.agent = dataclasses.replace(setup.agent, access=setup.access("/robot"))
    shown = SERVICE | proof(setup, "/viewer", Right.CALL, "/say")
    answer = {"callerid": b"/robot", "md5sum": b"0" * 32}
    admitted = run_layer(
        admit(setup, shown, TOPICS), (ConnectProgram(TOPICS, SERVICE), arrived(setup, answer))
    )
    assert admitted.service
    provided = answer | proof(setup, "/robot", Right.PROVIDE, "/say")
    assert admitted.answer == provided

    viewer = AgentSetup(setup.site, "/viewer")
    now = setup.site.now()
    there = run_layer(
        connect_to_peer(
            viewer.agent,
            PEER,
            SERVICE | {"callerid": b"/rosservice"},
            no_key,
            memory_scope("/viewer").child,
            now,
        ),
        (ConnectPeer(PEER, shown), arrived(setup, provided, "/robot")),
    )
    assert there.answer == answer
    with pytest.raises(GrantMissing):
        run_layer(
            connect_to_peer(
                viewer.agent, PEER, SERVICE, no_key, memory_scope("/viewer").child, now
            ),
            (ConnectPeer(PEER, shown), arrived(setup, answer, "/robot")),
        )


def test_a_program_subscribes_with_its_grants(setup: AgentSetup, shown: Fields) -> None:
    viewer = AgentSetup(setup.site, "/viewer")
    now = setup.site.now()
    everything = ASKED | {"type": b"*", "md5sum": b"*"}
    proven = ANSWER | {"topic": b"/word"} | proof(setup, "/robot", Right.PUBLISH, "/word")
    meet = ConnectPeer(PEER, everything | {FIELD: shown[FIELD]})
    admitted = run_layer(
        connect_to_peer(viewer.agent, PEER, everything, no_key, memory_scope("/viewer").child, now),
        (meet, arrived(setup, proven, "/robot")),
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
                connect_to_peer(
                    viewer.agent, PEER, everything, no_key, memory_scope("/viewer").child, now
                ),
                (meet, event),
            )


@pytest.mark.parametrize("both", [{"topic": b"/secret"}, {"topic": b""}])
def test_a_header_is_for_a_topic_or_for_a_service(setup: AgentSetup, both: Fields) -> None:
    """A right to call must not read a topic: stock programs look for the topic first."""
    setup.site.grant("/viewer", Right.CALL, "/say")
    shown = SERVICE | proof(setup, "/viewer", Right.CALL, "/say")
    for fields in (shown | both, {"callerid": b"/viewer"}):
        with pytest.raises(ConnectionHeaderRefused, match="for a topic or for a service"):
            run_layer(admit(setup, fields))
        with pytest.raises(ConnectionHeaderRefused, match="for a topic or for a service"):
            run_layer(
                connect_to_peer(
                    setup.agent,
                    PEER,
                    fields,
                    no_key,
                    memory_scope("/robot").child,
                    setup.site.now(),
                )
            )


def test_restrictions_on_calls_are_refused_not_ignored(setup: AgentSetup) -> None:
    """Both ways: no header of a service has the definition to apply them by."""
    limited = Restriction("std_srvs/SetBool", ("msg.data",))
    setup.site.grant("/viewer", Right.CALL, "/say", restriction=limited)
    shown = SERVICE | proof(setup, "/viewer", Right.CALL, "/say")
    with pytest.raises(RestrictionMismatch):
        run_layer(admit(setup, shown, TOPICS))
    setup.site.grant("/viewer", Right.PROVIDE, "/do", restriction=limited)
    asked = {"callerid": b"/robot", "service": b"/do", "md5sum": b"*"}
    answer = {"callerid": b"/viewer", **proof(setup, "/viewer", Right.PROVIDE, "/do")}
    layer = connect_to_peer(
        setup.agent, PEER, asked, no_key, memory_scope("/robot").child, setup.site.now()
    )
    command = next(layer)
    assert isinstance(command, ConnectPeer)
    with pytest.raises(RestrictionMismatch):
        layer.send(arrived(setup, answer, "/viewer"))


def test_a_restricted_publisher_gets_a_guard(setup: AgentSetup, shown: Fields) -> None:
    restriction = Restriction("std_msgs/String", ('msg.data == "go"',))
    setup.site.grant("/robot", Right.PUBLISH, "/word", restriction=restriction)
    viewer, now = AgentSetup(setup.site, "/viewer"), setup.site.now()
    proven = ANSWER | {"topic": b"/word"} | proof(setup, "/robot", Right.PUBLISH, "/word")
    meet = ConnectPeer(PEER, shown)
    layer = connect_to_peer(viewer.agent, PEER, ASKED, no_key, memory_scope("/viewer").child, now)
    admitted = run_layer(layer, (meet, arrived(setup, proven, "/robot")))
    assert admitted.guard is not None
    assert admitted.guard(b"\x04\0\0\0stop", now) is None
    layer = connect_to_peer(viewer.agent, PEER, ASKED, no_key, memory_scope("/viewer").child, now)
    undefined = proven | {"message_definition": b""}
    admitted = run_layer(layer, (meet, arrived(setup, undefined, "/robot")))
    assert admitted.answer["message_definition"].strip() == b"string data"  # as this host knows it
    viewer.agent.known_types = lambda _: None
    layer = connect_to_peer(viewer.agent, PEER, ASKED, no_key, memory_scope("/viewer").child, now)
    with pytest.raises(
        ConnectionHeaderRefused, match="how this subscriber reads a std_msgs/String"
    ):
        run_layer(layer, (meet, arrived(setup, undefined, "/robot")))
