"""What peers ask programs, and programs peers."""

from dataclasses import replace

import pytest

from ca.errors import CAError, RevocationsStale, Revoked
from grants.errors import GrantMissing
from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.errors import CallRefused, HangUp
from rossec.participant.slave_api import NO_TRANSPORT
from rossec.ros.xmlrpc import Encoded, Fault
from rossec.sidecar.core.commands import (
    AskLocal,
    AskRemote,
    OpenEgress,
    OpenIngress,
    Probe,
    Suspend,
)
from rossec.sidecar.core.endpoints import Endpoint, inside, topics_of
from rossec.sidecar.core.events import Answered, CommandDone, Event, NoAnswer, Opened, Passed
from rossec.sidecar.core.layers import Layer, UnexpectedEvent
from rossec.sidecar.core.slave_calls import ask_peer, ask_program
from tests.rossec.sidecar.playbook import HOST, MASTER_URI, Stage, play

SLAVE = inside(WireProtocol.HTTP, 5000)
PEER = Endpoint(WireProtocol.HTTP, "10.0.0.7", 6000)
DOOR = "http://127.0.0.1:8000/"
UDP = ["UDPROS", b"header", "host", 1, 1500]


def asked(
    stage: Stage, method: str, *params: object, peer: str = "/viewer", shown: bytes | None = None
) -> Layer[object]:
    everything = (peer, *params)
    return ask_program(
        stage.tenant, SLAVE, stage.identity(peer), method, everything, shown, stage.site.now()
    )


def test_the_master_steers(stage: Stage) -> None:
    params = ("/master", "/scan", [PEER.uri, "nonsense"])
    answer = play(
        asked(stage, "publisherUpdate", *params[1:], peer="/master"),
        (OpenEgress(PEER), Opened(8000)),
        (
            AskLocal(SLAVE, "publisherUpdate", ("/master", "/scan", ["http://127.0.0.1:8000/"])),
            Answered([1, "", 0]),
        ),
    )
    assert answer == [1, "", 0]


@pytest.mark.parametrize("method", ["publisherUpdate", "paramUpdate"])
def test_nobody_else_steers(stage: Stage, method: str) -> None:
    """Attacks N2 and N3."""
    with pytest.raises(CallRefused, match="for the master alone"):
        play(asked(stage, method, "/scan", []))


@pytest.mark.parametrize("method", ["launch", "system.multicall", "rossec.revocations", ""])
def test_no_other_method_gets_through(stage: Stage, method: str) -> None:
    """L1: a roslaunch child would run what it is sent; not even the master may ask for that."""
    for peer in ("/viewer", "/master"):
        with pytest.raises(CallRefused, match="no such method"):
            play(asked(stage, method, peer=peer))


def test_questions_need_the_right_to_see_the_graph(stage: Stage) -> None:
    """N4."""
    with pytest.raises(GrantMissing):
        play(asked(stage, "getPid"))
    stage.site.grant("/viewer", Right.GRAPH, "/robot")
    shown = stage.access("/viewer").present(Right.GRAPH, "/robot", stage.site.now())
    stats = AskLocal(SLAVE, "getBusStats", ("/viewer",), parse=False)
    answer = play(asked(stage, "getBusStats", shown=shown), (stats, Passed(b"<malformed")))
    assert answer == Encoded(b"<malformed")
    with pytest.raises(GrantMissing):
        play(asked(stage, "shutdown", "because", shown=shown))


def test_an_administrator_may_end_a_program(stage: Stage) -> None:
    """N1."""
    stage.site.grant("/viewer", Right.ADMIN, "/robot")
    shown = stage.access("/viewer").present(Right.ADMIN, "/robot", stage.site.now())
    ask = AskLocal(SLAVE, "shutdown", ("/viewer", "because"))
    play(asked(stage, "shutdown", "because", shown=shown), (ask, Answered([1, "", 0])))


@pytest.mark.parametrize("topic", ["/scan", "/nothing", "no name"])
def test_the_same_door_is_offered_for_every_topic(stage: Stage, topic: object) -> None:
    """N5: the program is not asked, so nothing in the answer can depend on it."""
    answer = play(
        asked(stage, "requestTopic", topic, [UDP, ["TCPROS"]]),
        (Probe(SLAVE), CommandDone()),
        (OpenIngress(topics_of(SLAVE)), Opened(7001)),
    )
    assert answer == [1, "ready", ["TCPROS", HOST, 7001]]


@pytest.mark.parametrize("offers", [[UDP], [], 7, ["TCPROS"]])
def test_udp_is_never_asked_for(stage: Stage, offers: object) -> None:
    """N10, both ways."""
    refused = [-1, NO_TRANSPORT, []]
    assert play(asked(stage, "requestTopic", "/scan", offers)) == refused
    mine = ask_peer(stage.tenant, PEER, "requestTopic", ("/robot", "/scan", offers))
    assert play(mine) == refused


@pytest.mark.parametrize("offer", [UDP, [], ["TCPROS", "h", 0], ["TCPROS", "h", 1 << 16], 0])
def test_udp_is_never_offered(stage: Stage, offer: object) -> None:
    params = ("/viewer", "/scan", [["TCPROS"]])
    mine = AskRemote(PEER, "requestTopic", ("/robot", *params[1:]), None)
    layer = ask_peer(stage.tenant, PEER, "requestTopic", ("/robot", *params[1:]))
    assert play(layer, (mine, Answered([1, "", offer]))) == [-1, NO_TRANSPORT, []]


def test_no_peer_sends_a_program_to_its_own_door(stage: Stage) -> None:
    """A program may reach itself, where it was told of itself: not as another's topic."""
    stage.tenant.doors.opened_outside(inside(WireProtocol.TCPROS, 5000), 4001)
    params = ("/robot", "/scan", [["TCPROS"]])
    ask = AskRemote(PEER, "requestTopic", params, None)
    for host in (HOST, HOST.upper()):
        layer = ask_peer(stage.tenant, PEER, "requestTopic", params)
        answer = Answered([1, "ready", ["TCPROS", host, 4001]])
        assert play(layer, (ask, answer)) == [-1, NO_TRANSPORT, []]


def test_what_a_program_says_of_itself_names_doors(stage: Stage) -> None:
    stage.tenant.doors.opened_inside(PEER, 8000)
    info = [
        [1, "http://127.0.0.1:8000/", "i", "TCPROS", "/scan", True],
        [2, "http://127.0.0.1:9999/", "i", "TCPROS", "/scan", True],
        [3, "/viewer", "o", "TCPROS", "/pose", True],
        [4, SLAVE.uri, "i", "INTRAPROCESS", "/loop", True],
        [5, 7, "i"],
    ]
    door = ((OpenIngress(SLAVE), Opened(7000)),)
    own = f"http://{HOST}:7000/"
    seen = [[1, PEER.uri, *info[0][2:]], *info[1:3], [4, own, *info[3][2:]], info[4]]
    for method, value, script, expected in (
        ("getBusInfo", info, door, seen),
        ("getUri", SLAVE.uri, door, own),
        ("getMasterUri", MASTER_URI, (), ""),
    ):
        ask = AskLocal(SLAVE, method, ("/master",))
        layer = asked(stage, method, peer="/master")
        assert play(layer, (ask, Answered([1, "", value])), *script) == [1, "", expected]
    ask = AskLocal(SLAVE, "getBusInfo", ("/master",))
    layer = asked(stage, "getBusInfo", peer="/master")
    assert play(layer, (ask, Answered([-1, "no", 0]))) == [-1, "no", 0]
    layer = asked(stage, "getBusInfo", peer="/master")
    assert play(layer, (ask, Answered([1, "", 7]))) == [1, "", 7]


def test_a_dead_program_answers_like_a_dead_node(stage: Stage) -> None:
    knock = asked(stage, "rossec.presentGrants", b"")
    assert play(knock, (Probe(SLAVE), CommandDone())) == [1, "", 0]
    with pytest.raises(HangUp):
        play(
            asked(stage, "rossec.presentGrants", b""),
            (Probe(SLAVE), NoAnswer("refused", dead=True)),
            (Suspend(SLAVE), CommandDone()),
        )
    ask = AskLocal(SLAVE, "getPid", ("/master",))
    with pytest.raises(HangUp):
        play(asked(stage, "getPid", peer="/master"), (ask, NoAnswer("slow")))
    with pytest.raises(UnexpectedEvent):
        play(asked(stage, "getPid", peer="/master"), (ask, CommandDone()))


def test_a_revoked_peer_does_not_even_knock(stage: Stage) -> None:
    """Nor one of which nobody knows: whether a program lives is told to those who hold."""
    viewer, params = stage.identity("/viewer"), ("/viewer", b"")

    def refused(now: int, error: type[CAError]) -> None:
        for method in ("rossec.presentGrants", "requestTopic"):
            with pytest.raises(error):
                play(ask_program(stage.tenant, SLAVE, viewer, method, params, None, now))

    refused(stage.site.now() + 60, RevocationsStale)
    stage.site.revoke(viewer.thumbprint)
    stage.tenant = replace(stage.tenant, access=stage.access("/robot"))
    refused(stage.site.now(), Revoked)


def test_a_call_needs_a_caller(stage: Stage) -> None:
    master, now = stage.identity("/master"), stage.site.now()
    missing, odd = "missing required caller_id parameter", "caller_id must be a string"
    for method, default in (("getPid", -1), ("getBusInfo", []), ("getName", "")):
        for params, said in (((), missing), ((7,), odd)):
            answer = [-1, said, default]
            assert play(ask_peer(stage.tenant, PEER, method, params)) == answer
            layer = ask_program(stage.tenant, SLAVE, master, method, params, None, now)
            assert play(layer) == answer
    short = [-1, "Error: bad call arity", []]
    assert play(asked(stage, "requestTopic", "/scan")) == short
    assert play(ask_peer(stage.tenant, PEER, "requestTopic", ("/robot", "/scan"))) == short
    for topic in ("", 7):
        nameless = [-1, "ERROR: parameter [topic] must be a non-empty string", []]
        assert play(asked(stage, "requestTopic", topic, [["TCPROS"]])) == nameless


def test_a_program_asks_under_its_certified_name_and_with_its_grants(stage: Stage) -> None:
    for method, right in (("getPid", Right.GRAPH), ("shutdown", Right.ADMIN)):
        ask = AskRemote(PEER, method, ("/robot",), right)
        layer = ask_peer(stage.tenant, PEER, method, ("/rosnode",))
        assert play(layer, (ask, Answered([1, "", 7]))) == [1, "", 7]
    stats = AskRemote(PEER, "getBusStats", ("/robot",), Right.GRAPH, parse=False)
    layer = ask_peer(stage.tenant, PEER, "getBusStats", ("/rosnode",))
    assert play(layer, (stats, Passed(b"<malformed"))) == Encoded(b"<malformed")
    with pytest.raises(Fault, match="not supported"):
        play(ask_peer(stage.tenant, PEER, "launch", ("/robot", "<launch/>")))


def test_a_peers_topics_are_met_at_a_door(stage: Stage) -> None:
    params = ("/robot", "/scan", [["TCPROS"]])
    remote = Endpoint(WireProtocol.TCPROS, "10.0.0.7", 6001)
    answer = play(
        ask_peer(stage.tenant, PEER, "requestTopic", params),
        (
            AskRemote(PEER, "requestTopic", params, None),
            Answered([1, "ready", ["TCPROS", remote.host, remote.port]]),
        ),
        (OpenEgress(remote), Opened(8001)),
    )
    assert answer == [1, "ready", ["TCPROS", "127.0.0.1", 8001]]


@pytest.mark.parametrize(
    ("method", "value", "script", "expected"),
    [
        ("getUri", "http://x:1/", [(OpenEgress(PEER), Opened(8000))], "http://127.0.0.1:8000/"),
        ("getMasterUri", "http://x:1/", [], MASTER_URI),
        ("getBusInfo", [[1], [2, "/x", "o"]], [], [[1], [2, "/x", "o"]]),
        ("getBusInfo", 7, [], 7),
        (
            "getBusInfo",
            [[1, PEER.uri, "i", "TCPROS"], [2, PEER.uri, "i", "TCPROS"], [3, "odd", "i"]],
            [(OpenEgress(PEER), Opened(8000))],
            [[1, DOOR, "i", "TCPROS"], [2, DOOR, "i", "TCPROS"], [3, "odd", "i"]],
        ),
    ],
)
def test_what_a_peer_says_names_doors(
    stage: Stage,
    method: str,
    value: object,
    script: list[tuple[OpenEgress, Event]],
    expected: object,
) -> None:
    ask = AskRemote(PEER, method, ("/robot",), Right.GRAPH)
    layer = ask_peer(stage.tenant, PEER, method, ("/robot",))
    assert play(layer, (ask, Answered([1, "", value])), *script) == [1, "", expected]


def test_what_a_peer_hears_from_this_identity_is_named_as_lookup_names_it(stage: Stage) -> None:
    outside = stage.tenant.doors.opened_outside(SLAVE, 7000)
    layer = ask_peer(stage.tenant, PEER, "getBusInfo", ("/robot",))
    ask = AskRemote(PEER, "getBusInfo", ("/robot",), Right.GRAPH)
    answer = play(layer, (ask, Answered([1, "", [[1, outside.uri, "i"]]])))
    assert answer == [1, "", [[1, SLAVE.uri, "i"]]]


def test_a_peer_cannot_have_any_number_of_doors_opened(stage: Stage) -> None:
    uris = [f"http://10.0.0.7:{port}/" for port in range(1, 100)]
    layer = ask_peer(stage.tenant, PEER, "getBusInfo", ("/robot",))
    ask = AskRemote(PEER, "getBusInfo", ("/robot",), Right.GRAPH)
    doors = [
        (OpenEgress(Endpoint(WireProtocol.HTTP, "10.0.0.7", port)), Opened(8000 + port))
        for port in range(1, 65)
    ]
    answer = play(layer, (ask, Answered([1, "", [[1, uri, "i"] for uri in uris]])), *doors)
    assert isinstance(answer, list)
    assert [entry[1] for entry in answer[2]][63:65] == ["http://127.0.0.1:8064/", uris[64]]


def test_a_peer_that_refuses_or_is_gone(stage: Stage) -> None:
    ask = AskRemote(PEER, "getBusInfo", ("/robot",), Right.GRAPH)
    layer = ask_peer(stage.tenant, PEER, "getBusInfo", ("/robot",))
    assert play(layer, (ask, Answered([-1, "rossec: no", 0]))) == [-1, "rossec: no", 0]
    for event, error in ((NoAnswer("gone"), HangUp), (CommandDone(), UnexpectedEvent)):
        with pytest.raises(error):
            play(ask_peer(stage.tenant, PEER, "getBusInfo", ("/robot",)), (ask, event))


ELSEWHERE = ["TCPROS", "203.0.113.5", 6666]
ODD = [
    ([2, "", ELSEWHERE], [-1, "", 0]),  # rospy: any code above 0 is success
    ([True, "", ELSEWHERE], [-1, "", 0]),
    ([1.0, "", ELSEWHERE], [-1, "", 0]),
    ([0, "later", ELSEWHERE], [0, "later", 0]),
    ([1, 7, ELSEWHERE], [-1, "rossec: an answer that is not [code, status, value]", 0]),
    ([1, ELSEWHERE], [-1, "rossec: an answer that is not [code, status, value]", 0]),
    (ELSEWHERE[0], [-1, "rossec: an answer that is not [code, status, value]", 0]),
]


@pytest.mark.parametrize(("answer", "expected"), ODD)
def test_no_address_hides_in_an_answer(stage: Stage, answer: object, expected: object) -> None:
    """The program would connect to it in clear."""
    params = ("/robot", "/scan", [["TCPROS"]])
    ask = AskRemote(PEER, "requestTopic", params, None)
    layer = ask_peer(stage.tenant, PEER, "requestTopic", params)
    assert play(layer, (ask, Answered(answer))) == expected
    mine = AskLocal(SLAVE, "getPid", ("/master",))
    layer = asked(stage, "getPid", peer="/master")
    assert play(layer, (mine, Answered(answer))) == expected


@pytest.mark.parametrize("method", ["requestTopic", "getPid"])
def test_an_answer_that_nobody_parsed_goes_no_further(stage: Stage, method: str) -> None:
    params = ("/robot", "/scan", [["TCPROS"]])
    for layer in (
        ask_peer(stage.tenant, PEER, method, params),
        asked(stage, "getPid", *params[1:], peer="/master"),
    ):
        command = next(layer)
        assert isinstance(command, AskRemote | AskLocal)
        assert command.parse
        with pytest.raises(UnexpectedEvent):
            layer.send(Passed(b"anything"))
