"""Connection headers between programs and peers."""

import dataclasses

import pytest

from ca.certificates import Identity
from grants.errors import GrantMissing
from grants.model import Restriction, Right, filter_rules
from rossec.errors import CallerMismatch, ConnectionHeaderRefused, HangUp
from rossec.participant.access import FIELD
from rossec.participant.header_fields import Fields
from rossec.participant.limit_memory import memory_scope
from rossec.participant.message_types import message_type
from rossec.sidecar.core.commands import ConnectPeer, ConnectProgram, Suspend
from rossec.sidecar.core.events import Answered, CommandDone, HeaderArrived, NoAnswer
from rossec.sidecar.core.layers import UnexpectedEvent
from rossec.sidecar.core.tcpros import admit_peer, connect_to_peer
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
from tests.support.openaccess import PROOF, OpenAccess


@pytest.fixture
def authorized(setup: AgentSetup) -> Fields:
    setup.site.subscribe("/viewer", "/word")
    setup.site.publish("/robot", "/word")
    setup.agent = dataclasses.replace(setup.agent, access=setup.access("/robot"))
    return REQUEST | proof(setup, "/viewer", Right.SUBSCRIBE, "/word")


def test_a_subscriber_with_a_grant_is_connected_to_the_program(
    setup: AgentSetup, authorized: Fields
) -> None:
    """The program gets no grant; the peer gets the program's; rospy omits the topic."""
    connect = ConnectProgram(TOPIC_ENDPOINT, REQUEST)
    admitted = run_layer(
        admit(setup, authorized), REQUEST_ANSWERED, (connect, arrived(setup, ANSWER))
    )
    expected = ANSWER | {"topic": b"/word"} | proof(setup, "/robot", Right.PUBLISH, "/word")
    assert admitted.answer == expected
    assert admitted.guard is None
    assert not admitted.service


def test_the_program_is_not_contacted_for_a_peer_without_grant(setup: AgentSetup) -> None:
    """N5: no byte is sent, and the refusal does not depend on whether the topic exists."""
    with pytest.raises(GrantMissing):
        run_layer(admit(setup, REQUEST))


def test_a_subscriber_with_another_caller_id_is_refused(
    setup: AgentSetup, authorized: Fields
) -> None:
    """N6."""
    with pytest.raises(CallerMismatch):
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
def test_an_unpublished_topic_is_refused(
    setup: AgentSetup, authorized: Fields, answer: object
) -> None:
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
    admitted = run_layer(
        admit(setup, restricted), REQUEST_ANSWERED, (connect, arrived(setup, ANSWER))
    )
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
        "callerid": b"/robot", "type": b"geometry_msgs/Twist", "md5sum": twist.md5sum.encode(),
        "message_definition": twist.definition.replace("Vector3 linear", "Vector3[0] linear")
        .replace("Vector3 angular", "Vector3[2] angular").encode(),
    }  # fmt: skip
    authorized = REQUEST | proof(setup, "/viewer", Right.SUBSCRIBE, "/word")
    with pytest.raises(ConnectionHeaderRefused, match="not the one this host knows"):
        run_layer(
            admit(setup, authorized),
            REQUEST_ANSWERED,
            (ConnectProgram(TOPIC_ENDPOINT, REQUEST), arrived(setup, answer)),
        )


def test_a_definition_is_not_checked_without_restrictions(
    setup: AgentSetup, authorized: Fields
) -> None:
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
                connect_to_peer(
                    viewer.agent, PEER, everything, no_key, memory_scope("/viewer").child, now
                ),
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
    with pytest.raises(
        ConnectionHeaderRefused, match="how this subscriber reads a std_msgs/String"
    ):
        run_layer(layer, (connect, arrived(setup, undefined, "/robot")))


def foreign(setup: AgentSetup, name: str) -> Identity:
    """The node of this name in the hospital's domain."""
    identity = setup.identity(name)
    return dataclasses.replace(identity, name=f"/remote/hospital{name}", certified=name)


def test_a_program_subscribes_to_an_alias_and_the_peer_reads_the_origins_name(
    setup: AgentSetup,
) -> None:
    access = OpenAccess(setup.site.anchor)
    setup.agent = dataclasses.replace(setup.agent, access=access)
    robot, alias = foreign(setup, "/robot"), b"/remote/hospital/word"
    fields = REQUEST | {"callerid": b"/robot", "topic": alias}
    layer = connect_to_peer(
        setup.agent, PEER, fields, no_key, memory_scope("/robot").child, setup.site.now()
    )
    connect = ConnectPeer(PEER, fields | {"topic": b"/word"} | PROOF)
    answer = HeaderArrived(ANSWER | {"topic": b"/word"} | PROOF, robot, setup.site.now())
    admitted = run_layer(layer, (connect, answer))
    assert access.presented == [("subscribe", alias.decode())]
    assert access.authorized == [("/remote/hospital/robot", "publish", alias.decode())]
    assert admitted.answer["topic"] == alias
    assert admitted.answer["callerid"] == b"/remote/hospital/robot"
    assert admitted.guard is None


def test_a_program_calls_an_alias_and_the_peer_reads_the_origins_name(setup: AgentSetup) -> None:
    access = OpenAccess(setup.site.anchor)
    setup.agent = dataclasses.replace(setup.agent, access=access)
    fields = SERVICE | {"callerid": b"/robot", "service": b"/remote/hospital/say"}
    layer = connect_to_peer(
        setup.agent, PEER, fields, no_key, memory_scope("/robot").child, setup.site.now()
    )
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
    setup.agent = dataclasses.replace(setup.agent, access=OpenAccess(setup.site.anchor))
    fields = REQUEST | {"callerid": b"/robot", "topic": b"/remote/hospital/word"}
    layer = connect_to_peer(
        setup.agent, PEER, fields, no_key, memory_scope("/robot").child, setup.site.now()
    )
    connect = ConnectPeer(PEER, fields | {"topic": b"/word"} | PROOF)
    answer = HeaderArrived(ANSWER | {"topic": topic}, foreign(setup, "/robot"), setup.site.now())
    with pytest.raises(ConnectionHeaderRefused, match="another topic than hospital:/word"):
        run_layer(layer, (connect, answer))


def test_a_foreign_subscriber_is_known_to_the_program_by_its_alias(setup: AgentSetup) -> None:
    access = OpenAccess(setup.site.anchor)
    setup.agent = dataclasses.replace(setup.agent, access=access)
    viewer = foreign(setup, "/viewer")
    layer = admit_peer(
        setup.agent, TOPICS_VIA_API, REQUEST, viewer, no_key,
        memory_scope("/robot").child, setup.site.now(),
    )  # fmt: skip
    caller = {"callerid": b"/remote/hospital/viewer"}
    request = dataclasses.replace(REQUEST_TOPIC, params=(viewer.name, *REQUEST_TOPIC.params[1:]))
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
    access = OpenAccess(setup.site.anchor)
    setup.agent = dataclasses.replace(setup.agent, access=access)
    local = TOPICS_VIA_API if "topic" in fields else TOPIC_ENDPOINT
    with pytest.raises(ConnectionHeaderRefused, match="no name on the wire"):
        run_layer(admit(setup, fields, local))
    assert access.authorized == []
