"""Connection headers between programs and peers."""

import dataclasses

import pytest

from grants.errors import GrantMissing, RestrictionMismatch
from grants.model import Restriction, Right, filter_rules
from rossec.channel.opening import WireProtocol
from rossec.errors import CallerMismatch, ConnectionHeaderRefused, HangUp
from rossec.participant.access import FIELD
from rossec.participant.header_fields import Fields
from rossec.participant.limit_memory import recall
from rossec.participant.message_types import message_type
from rossec.sidecar.core.commands import AskLocal, Command, ConnectPeer, ConnectProgram, Suspend
from rossec.sidecar.core.endpoints import Endpoint, inside, topics_of
from rossec.sidecar.core.events import Answered, CommandDone, Event, HeaderArrived, NoAnswer
from rossec.sidecar.core.layers import Layer, UnexpectedEvent
from rossec.sidecar.core.tcpros import AdmittedConnection, admit_peer, reach_peer
from tests.rossec.sidecar.playbook import Stage, play

SLAVE = inside(WireProtocol.HTTP, 5000)
DOOR = topics_of(SLAVE)
PLACE = ["TCPROS", "localhost", 5001]
TOPICS = inside(WireProtocol.TCPROS, 5001)
PEER = Endpoint(WireProtocol.TCPROS, "10.0.0.7", 6001)
STRING = {"type": b"std_msgs/String", "md5sum": b"992ce8a1687cec8c8bd883ec73ca41d1"}
ASKED = {"callerid": b"/viewer", "topic": b"/word", "tcp_nodelay": b"1", **STRING}
ANSWER = {"callerid": b"/robot", "message_definition": b"string data\n", "latching": b"0", **STRING}
SERVICE = {"callerid": b"/viewer", "service": b"/say", "md5sum": b"*"}


def no_key(name: str) -> bytes:
    raise AssertionError(name)


def proof(stage: Stage, name: str, right: Right, topic: str) -> Fields:
    return {FIELD: stage.access(name).present(right, topic, stage.site.now())}


def admit(stage: Stage, fields: Fields, door: Endpoint = DOOR) -> Layer[AdmittedConnection]:
    peer = stage.identity("/viewer")
    return admit_peer(
        stage.tenant, door, fields, peer, no_key, recall("/robot").child, stage.site.now()
    )


ASK = AskLocal(SLAVE, "requestTopic", ("/viewer", "/word", [["TCPROS"]]))
WHERE: tuple[Command, Event] = (ASK, Answered([1, "ready", PLACE]))
"""A program is asked where its topic is, and says so."""


def arrived(stage: Stage, fields: Fields, peer: str | None = None) -> HeaderArrived:
    who = None if peer is None else stage.identity(peer)
    return HeaderArrived(fields, who, stage.site.now())


@pytest.fixture
def shown(stage: Stage) -> Fields:
    stage.site.subscribe("/viewer", "/word")
    stage.site.publish("/robot", "/word")
    stage.tenant = dataclasses.replace(stage.tenant, access=stage.access("/robot"))
    return ASKED | proof(stage, "/viewer", Right.SUBSCRIBE, "/word")


def test_a_subscriber_with_a_grant_meets_the_program(stage: Stage, shown: Fields) -> None:
    """The program sees no grant; the peer sees the program's; rospy leaves out the topic."""
    meet = ConnectProgram(TOPICS, ASKED)
    joined = play(admit(stage, shown), WHERE, (meet, arrived(stage, ANSWER)))
    expected = ANSWER | {"topic": b"/word"} | proof(stage, "/robot", Right.PUBLISH, "/word")
    assert joined.answer == expected
    assert joined.guard is None
    assert not joined.service


def test_without_a_grant_the_program_does_not_hear_of_it(stage: Stage) -> None:
    """N5: not a byte, and no hint whether the topic exists."""
    with pytest.raises(GrantMissing):
        play(admit(stage, ASKED))


def test_a_subscriber_may_not_lie_about_its_name(stage: Stage, shown: Fields) -> None:
    """N6."""
    with pytest.raises(CallerMismatch):
        play(admit(stage, shown | {"callerid": b"/robot"}))


def test_the_programs_own_name_is_never_taken_on_trust(stage: Stage, shown: Fields) -> None:
    for given in (ANSWER | {"callerid": b"/victim"}, STRING):
        joined = play(
            admit(stage, shown), WHERE, (ConnectProgram(TOPICS, ASKED), arrived(stage, given))
        )
        assert joined.answer["callerid"] == b"/robot"


def test_what_the_program_refuses_is_passed_on(stage: Stage, shown: Fields) -> None:
    with pytest.raises(ConnectionHeaderRefused, match="no such topic"):
        play(
            admit(stage, shown),
            WHERE,
            (ConnectProgram(TOPICS, ASKED), arrived(stage, {"error": b"no such topic"})),
        )


def test_a_program_that_is_gone_closes_its_door(stage: Stage, shown: Fields) -> None:
    meet = ConnectProgram(TOPICS, ASKED)
    with pytest.raises(HangUp):
        play(
            admit(stage, shown),
            WHERE,
            (meet, NoAnswer("gone", dead=True)),
            (Suspend(DOOR), CommandDone()),
        )
    with pytest.raises(HangUp):
        play(admit(stage, shown), WHERE, (meet, NoAnswer("slow")))
    with pytest.raises(UnexpectedEvent):
        play(admit(stage, shown), WHERE, (meet, CommandDone()))


@pytest.mark.parametrize(
    "answer",
    [
        [0, "Not a publisher of [/word]", []], [-1, "no", PLACE], [1, "", []], [True, "", PLACE],
        [1, "", ["UDPROS", "h", 7]], [1, "", ["TCPROS", "h", 0]], [1, "", ["TCPROS", "h", 1 << 16]],
        PLACE, 7,
    ],
)  # fmt: skip
def test_what_the_program_does_not_publish(stage: Stage, shown: Fields, answer: object) -> None:
    """Only who may subscribe hears of it."""
    with pytest.raises(ConnectionHeaderRefused, match=r"^/robot does not publish /word$"):
        play(admit(stage, shown), (ASK, Answered(answer)))


def test_a_program_that_cannot_be_asked(stage: Stage, shown: Fields) -> None:
    with pytest.raises(HangUp):
        play(
            admit(stage, shown), (ASK, NoAnswer("gone", dead=True)), (Suspend(DOOR), CommandDone())
        )
    with pytest.raises(HangUp):
        play(admit(stage, shown), (ASK, NoAnswer("slow")))
    with pytest.raises(UnexpectedEvent):
        play(admit(stage, shown), (ASK, CommandDone()))


def test_topics_and_services_have_doors_of_their_own(stage: Stage, shown: Fields) -> None:
    """Whatever the right."""
    for fields in (shown, ASKED):
        with pytest.raises(ConnectionHeaderRefused, match="this port is not for topics"):
            play(admit(stage, fields, TOPICS))
    with pytest.raises(ConnectionHeaderRefused, match="this port is not for services"):
        play(admit(stage, SERVICE))


@pytest.fixture
def restricted(stage: Stage) -> Fields:
    rules = filter_rules({"data": {"clear": True}})
    stage.site.subscribe("/viewer", "/word", Restriction("std_msgs/String", (), rules))
    return ASKED | proof(stage, "/viewer", Right.SUBSCRIBE, "/word")


def test_a_restricted_subscriber_gets_a_guard(stage: Stage, restricted: Fields) -> None:
    meet = ConnectProgram(TOPICS, ASKED)
    joined = play(admit(stage, restricted), WHERE, (meet, arrived(stage, ANSWER)))
    assert joined.guard is not None
    pieces = joined.guard(b"\x05\0\0\0hello", stage.site.now())
    assert pieces is not None
    assert b"".join(pieces) == b"\0\0\0\0"


def test_a_definition_that_cannot_be_proved_is_refused(stage: Stage, restricted: Fields) -> None:
    meet = ConnectProgram(TOPICS, ASKED)
    answer = ANSWER | {"message_definition": b"int32 data\n"}
    with pytest.raises(ConnectionHeaderRefused, match="does not have the md5sum"):
        play(admit(stage, restricted), WHERE, (meet, arrived(stage, answer)))


def test_what_a_relay_repeats_is_not_taken_on_trust(stage: Stage) -> None:
    """Its own publisher may have described the type otherwise, under the same md5sum."""
    rules = filter_rules({"linear": {"clear": True}})
    stage.site.subscribe("/viewer", "/word", Restriction("geometry_msgs/Twist", (), rules))
    twist = message_type("geometry_msgs/Twist")
    said = {
        "callerid": b"/robot", "type": b"geometry_msgs/Twist", "md5sum": twist.md5sum.encode(),
        "message_definition": twist.definition.replace("Vector3 linear", "Vector3[0] linear")
        .replace("Vector3 angular", "Vector3[2] angular").encode(),
    }  # fmt: skip
    shown = ASKED | proof(stage, "/viewer", Right.SUBSCRIBE, "/word")
    with pytest.raises(ConnectionHeaderRefused, match="not the one this host knows"):
        play(admit(stage, shown), WHERE, (ConnectProgram(TOPICS, ASKED), arrived(stage, said)))


def test_a_definition_that_nobody_looks_at_may_be_anything(stage: Stage, shown: Fields) -> None:
    said = ANSWER | {"message_definition": b"# caf\xe9\nstring data"}
    joined = play(admit(stage, shown), WHERE, (ConnectProgram(TOPICS, ASKED), arrived(stage, said)))
    assert joined.answer["message_definition"] == said["message_definition"]


def test_services_both_ways(stage: Stage) -> None:
    stage.site.grant("/viewer", Right.CALL, "/say")
    stage.site.grant("/robot", Right.PROVIDE, "/say")
    stage.tenant = dataclasses.replace(stage.tenant, access=stage.access("/robot"))
    shown = SERVICE | proof(stage, "/viewer", Right.CALL, "/say")
    answer = {"callerid": b"/robot", "md5sum": b"0" * 32}
    joined = play(
        admit(stage, shown, TOPICS), (ConnectProgram(TOPICS, SERVICE), arrived(stage, answer))
    )
    assert joined.service
    provided = answer | proof(stage, "/robot", Right.PROVIDE, "/say")
    assert joined.answer == provided

    viewer = Stage(stage.site, "/viewer")
    now = stage.site.now()
    there = play(
        reach_peer(
            viewer.tenant,
            PEER,
            SERVICE | {"callerid": b"/rosservice"},
            no_key,
            recall("/viewer").child,
            now,
        ),
        (ConnectPeer(PEER, shown), arrived(stage, provided, "/robot")),
    )
    assert there.answer == answer
    with pytest.raises(GrantMissing):
        play(
            reach_peer(viewer.tenant, PEER, SERVICE, no_key, recall("/viewer").child, now),
            (ConnectPeer(PEER, shown), arrived(stage, answer, "/robot")),
        )


def test_a_program_subscribes_with_its_grants(stage: Stage, shown: Fields) -> None:
    viewer = Stage(stage.site, "/viewer")
    now = stage.site.now()
    everything = ASKED | {"type": b"*", "md5sum": b"*"}
    proven = ANSWER | {"topic": b"/word"} | proof(stage, "/robot", Right.PUBLISH, "/word")
    meet = ConnectPeer(PEER, everything | {FIELD: shown[FIELD]})
    joined = play(
        reach_peer(viewer.tenant, PEER, everything, no_key, recall("/viewer").child, now),
        (meet, arrived(stage, proven, "/robot")),
    )
    assert joined.answer == ANSWER | {"topic": b"/word"}
    assert joined.guard is None
    unproven = ANSWER | {"topic": b"/word"}
    for event, error in (
        (arrived(stage, unproven, "/robot"), GrantMissing),
        (arrived(stage, proven), UnexpectedEvent),
        (NoAnswer("gone"), HangUp),
    ):
        with pytest.raises(error):
            play(
                reach_peer(viewer.tenant, PEER, everything, no_key, recall("/viewer").child, now),
                (meet, event),
            )


@pytest.mark.parametrize("both", [{"topic": b"/secret"}, {"topic": b""}])
def test_a_header_is_for_a_topic_or_for_a_service(stage: Stage, both: Fields) -> None:
    """A right to call must not read a topic: stock programs look for the topic first."""
    stage.site.grant("/viewer", Right.CALL, "/say")
    shown = SERVICE | proof(stage, "/viewer", Right.CALL, "/say")
    for fields in (shown | both, {"callerid": b"/viewer"}):
        with pytest.raises(ConnectionHeaderRefused, match="for a topic or for a service"):
            play(admit(stage, fields))
        with pytest.raises(ConnectionHeaderRefused, match="for a topic or for a service"):
            play(
                reach_peer(
                    stage.tenant, PEER, fields, no_key, recall("/robot").child, stage.site.now()
                )
            )


def test_restrictions_on_calls_are_refused_not_ignored(stage: Stage) -> None:
    """Both ways: no header of a service has the definition to apply them by."""
    limited = Restriction("std_srvs/SetBool", ("msg.data",))
    stage.site.grant("/viewer", Right.CALL, "/say", restriction=limited)
    shown = SERVICE | proof(stage, "/viewer", Right.CALL, "/say")
    with pytest.raises(RestrictionMismatch):
        play(admit(stage, shown, TOPICS))
    stage.site.grant("/viewer", Right.PROVIDE, "/do", restriction=limited)
    asked = {"callerid": b"/robot", "service": b"/do", "md5sum": b"*"}
    answer = {"callerid": b"/viewer", **proof(stage, "/viewer", Right.PROVIDE, "/do")}
    layer = reach_peer(stage.tenant, PEER, asked, no_key, recall("/robot").child, stage.site.now())
    command = next(layer)
    assert isinstance(command, ConnectPeer)
    with pytest.raises(RestrictionMismatch):
        layer.send(arrived(stage, answer, "/viewer"))


def test_a_restricted_publisher_gets_a_guard(stage: Stage, shown: Fields) -> None:
    restriction = Restriction("std_msgs/String", ('msg.data == "go"',))
    stage.site.grant("/robot", Right.PUBLISH, "/word", restriction=restriction)
    viewer, now = Stage(stage.site, "/viewer"), stage.site.now()
    proven = ANSWER | {"topic": b"/word"} | proof(stage, "/robot", Right.PUBLISH, "/word")
    meet = ConnectPeer(PEER, shown)
    layer = reach_peer(viewer.tenant, PEER, ASKED, no_key, recall("/viewer").child, now)
    joined = play(layer, (meet, arrived(stage, proven, "/robot")))
    assert joined.guard is not None
    assert joined.guard(b"\x04\0\0\0stop", now) is None
    layer = reach_peer(viewer.tenant, PEER, ASKED, no_key, recall("/viewer").child, now)
    undefined = proven | {"message_definition": b""}
    joined = play(layer, (meet, arrived(stage, undefined, "/robot")))
    assert joined.answer["message_definition"].strip() == b"string data"  # as this host knows it
    viewer.tenant.known = lambda _: None
    layer = reach_peer(viewer.tenant, PEER, ASKED, no_key, recall("/viewer").child, now)
    with pytest.raises(
        ConnectionHeaderRefused, match="how this subscriber reads a std_msgs/String"
    ):
        play(layer, (meet, arrived(stage, undefined, "/robot")))
