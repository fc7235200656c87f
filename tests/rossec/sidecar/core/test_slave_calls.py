"""Slave API calls of peers to programs, and of programs to peers."""

from dataclasses import replace

import pytest

from ca.errors import CAError, RevocationsStale, Revoked
from grants.errors import GrantMissing
from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.errors import HangUp, RossecError
from rossec.participant.slave_api import NO_TRANSPORT
from rossec.ros.xmlrpc import Encoded, Fault
from rossec.sidecar.core.layers import (
    Answered,
    CallPeer,
    CallProgram,
    CommandDone,
    Event,
    Layer,
    ListeningAddress,
    NoAnswer,
    OpenEgress,
    OpenIngress,
    PortOpened,
    Probe,
    RawResponse,
    Suspend,
    UnexpectedEvent,
    local_endpoint,
    topic_endpoint,
)
from rossec.sidecar.core.node_connections import handle_peer_call, handle_program_call
from tests.rossec.sidecar.agent_setup import HOST, MASTER_URI, AgentSetup, run_layer

SLAVE = local_endpoint(WireProtocol.HTTP, 5000)
PEER = ListeningAddress(WireProtocol.HTTP, "10.0.0.7", 6000)
EGRESS_URI = "http://127.0.0.1:8000/"
UDP = ["UDPROS", b"header", "host", 1, 1500]


def peer_call(
    setup: AgentSetup, method: str, *params: object, peer: str = "/viewer", grants: bytes | None = None
) -> Layer[object]:
    everything = (peer, *params)
    return handle_peer_call(
        setup.agent, SLAVE, setup.identity(peer), method, everything, grants, setup.site.now()
    )


def test_updates_of_the_master_are_forwarded(setup: AgentSetup) -> None:
    params = ("/master", "/scan", [PEER.uri, "nonsense"])
    answer = run_layer(
        peer_call(setup, "publisherUpdate", *params[1:], peer="/master"),
        (OpenEgress(PEER), PortOpened(8000)),
        (
            CallProgram(SLAVE, "publisherUpdate", ("/master", "/scan", ["http://127.0.0.1:8000/"])),
            Answered([1, "", 0]),
        ),
    )
    assert answer == [1, "", 0]


@pytest.mark.parametrize("method", ["publisherUpdate", "paramUpdate"])
def test_updates_of_other_peers_are_refused(setup: AgentSetup, method: str) -> None:
    """Attacks N2 and N3."""
    with pytest.raises(RossecError, match="for the master alone"):
        run_layer(peer_call(setup, method, "/scan", []))


@pytest.mark.parametrize("method", ["launch", "system.multicall", "rossec.revocations", ""])
def test_unknown_methods_are_refused(setup: AgentSetup, method: str) -> None:
    """L1: a roslaunch child would execute what it is sent; not even the master is allowed to."""
    for peer in ("/viewer", "/master"):
        with pytest.raises(RossecError, match="no such method"):
            run_layer(peer_call(setup, method, peer=peer))


def test_slave_calls_need_the_graph_right(setup: AgentSetup) -> None:
    """N4."""
    with pytest.raises(GrantMissing):
        run_layer(peer_call(setup, "getPid"))
    setup.site.grant("/viewer", Right.GRAPH, "/robot")
    grants = setup.access("/viewer").present(Right.GRAPH, "/robot", setup.site.now())
    asked = CallProgram(SLAVE, "getPid", ("/viewer",))
    answer = run_layer(peer_call(setup, "getPid", grants=grants), (asked, Answered([1, "", 7])))
    assert answer == [1, "", 7]
    stats = run_layer(peer_call(setup, "getBusStats", grants=grants))
    assert stats == [1, "", [[], [], []]], "they would count what a grant withholds"
    with pytest.raises(GrantMissing):
        run_layer(peer_call(setup, "shutdown", "because", grants=grants))


def test_the_admin_right_allows_shutdown(setup: AgentSetup) -> None:
    """N1."""
    setup.site.grant("/viewer", Right.ADMIN, "/robot")
    grants = setup.access("/viewer").present(Right.ADMIN, "/robot", setup.site.now())
    request = CallProgram(SLAVE, "shutdown", ("/viewer", "because"))
    run_layer(peer_call(setup, "shutdown", "because", grants=grants), (request, Answered([1, "", 0])))


@pytest.mark.parametrize("topic", ["/scan", "/nothing", "no name"])
def test_the_same_port_is_offered_for_every_topic(setup: AgentSetup, topic: object) -> None:
    """N5: the program is not called, so the answer cannot depend on it."""
    answer = run_layer(
        peer_call(setup, "requestTopic", topic, [UDP, ["TCPROS"]]),
        (Probe(SLAVE), CommandDone()),
        (OpenIngress(topic_endpoint(SLAVE)), PortOpened(7001)),
    )
    assert answer == [1, "ready", ["TCPROS", HOST, 7001]]


@pytest.mark.parametrize("offers", [[UDP], [], 7, ["TCPROS"]])
def test_udpros_is_never_requested(setup: AgentSetup, offers: object) -> None:
    """N10, in both directions."""
    refused = [-1, NO_TRANSPORT, []]
    assert run_layer(peer_call(setup, "requestTopic", "/scan", offers)) == refused
    request = handle_program_call(setup.agent, PEER, "requestTopic", ("/robot", "/scan", offers))
    assert run_layer(request) == refused


@pytest.mark.parametrize("offer", [UDP, [], ["TCPROS", "h", 0], ["TCPROS", "h", 1 << 16], 0])
def test_udpros_is_never_offered(setup: AgentSetup, offer: object) -> None:
    params = ("/viewer", "/scan", [["TCPROS"]])
    request = CallPeer(PEER, "requestTopic", ("/robot", *params[1:]), None)
    layer = handle_program_call(setup.agent, PEER, "requestTopic", ("/robot", *params[1:]))
    assert run_layer(layer, (request, Answered([1, "", offer]))) == [-1, NO_TRANSPORT, []]


def test_a_peer_cannot_redirect_a_program_to_itself(setup: AgentSetup) -> None:
    """A program may connect to itself, but not by the answer of another node."""
    setup.agent.endpoints.add_ingress(local_endpoint(WireProtocol.TCPROS, 5000), 4001)
    params = ("/robot", "/scan", [["TCPROS"]])
    request = CallPeer(PEER, "requestTopic", params, None)
    for host in (HOST, HOST.upper()):
        layer = handle_program_call(setup.agent, PEER, "requestTopic", params)
        answer = Answered([1, "ready", ["TCPROS", host, 4001]])
        assert run_layer(layer, (request, answer)) == [-1, NO_TRANSPORT, []]


def test_answers_of_a_program_name_ingress_endpoints(setup: AgentSetup) -> None:
    setup.agent.endpoints.add_egress(PEER, 8000)
    info = [
        [1, "http://127.0.0.1:8000/", "i", "TCPROS", "/scan", True],
        [2, "http://127.0.0.1:9999/", "i", "TCPROS", "/scan", True],
        [3, "/viewer", "o", "TCPROS", "/pose", True],
        [4, SLAVE.uri, "i", "INTRAPROCESS", "/loop", True],
        [5, 7, "i"],
    ]
    ingress = ((OpenIngress(SLAVE), PortOpened(7000)),)
    own = f"http://{HOST}:7000/"
    seen = [[1, PEER.uri, *info[0][2:]], *info[1:3], [4, own, *info[3][2:]], info[4]]
    for method, value, script, expected in (
        ("getBusInfo", info, ingress, seen),
        ("getUri", SLAVE.uri, ingress, own),
        ("getMasterUri", MASTER_URI, (), ""),
    ):
        request = CallProgram(SLAVE, method, ("/master",))
        layer = peer_call(setup, method, peer="/master")
        assert run_layer(layer, (request, Answered([1, "", value])), *script) == [1, "", expected]
    request = CallProgram(SLAVE, "getBusInfo", ("/master",))
    layer = peer_call(setup, "getBusInfo", peer="/master")
    assert run_layer(layer, (request, Answered([-1, "no", 0]))) == [-1, "no", 0]
    layer = peer_call(setup, "getBusInfo", peer="/master")
    assert run_layer(layer, (request, Answered([1, "", 7]))) == [1, "", 7]


def test_a_dead_program_answers_like_a_dead_node(setup: AgentSetup) -> None:
    probe = peer_call(setup, "rossec.presentGrants", b"")
    assert run_layer(probe, (Probe(SLAVE), CommandDone())) == [1, "", 0]
    with pytest.raises(HangUp):
        run_layer(
            peer_call(setup, "rossec.presentGrants", b""),
            (Probe(SLAVE), NoAnswer("refused", dead=True)),
            (Suspend(SLAVE), CommandDone()),
        )
    request = CallProgram(SLAVE, "getPid", ("/master",))
    with pytest.raises(HangUp):
        run_layer(peer_call(setup, "getPid", peer="/master"), (request, NoAnswer("slow")))
    with pytest.raises(UnexpectedEvent):
        run_layer(peer_call(setup, "getPid", peer="/master"), (request, CommandDone()))


def test_a_program_is_not_probed_for_a_revoked_peer(setup: AgentSetup) -> None:
    """Nor for one of unknown status: only valid peers learn whether a program is alive."""
    viewer, params = setup.identity("/viewer"), ("/viewer", b"")

    def refused(now: int, error: type[CAError]) -> None:
        for method in ("rossec.presentGrants", "requestTopic"):
            with pytest.raises(error):
                run_layer(handle_peer_call(setup.agent, SLAVE, viewer, method, params, None, now))

    refused(setup.site.now() + 60, RevocationsStale)
    setup.site.revoke(viewer.thumbprint)
    setup.agent = replace(setup.agent, access=setup.access("/robot"))
    refused(setup.site.now(), Revoked)


def test_a_call_needs_a_caller_id(setup: AgentSetup) -> None:
    master, now = setup.identity("/master"), setup.site.now()
    missing, odd = "missing required caller_id parameter", "caller_id must be a string"
    for method, default in (("getPid", -1), ("getBusInfo", []), ("getName", "")):
        for params, status in (((), missing), ((7,), odd)):
            answer = [-1, status, default]
            assert run_layer(handle_program_call(setup.agent, PEER, method, params)) == answer
            layer = handle_peer_call(setup.agent, SLAVE, master, method, params, None, now)
            assert run_layer(layer) == answer
    short = [-1, "Error: bad call arity", []]
    assert run_layer(peer_call(setup, "requestTopic", "/scan")) == short
    assert run_layer(handle_program_call(setup.agent, PEER, "requestTopic", ("/robot", "/scan"))) == short
    for topic in ("", 7):
        nameless = [-1, "ERROR: parameter [topic] must be a non-empty string", []]
        assert run_layer(peer_call(setup, "requestTopic", topic, [["TCPROS"]])) == nameless


def test_calls_of_a_program_have_a_certified_caller_id_and_its_grants(setup: AgentSetup) -> None:
    for method, right in (("getPid", Right.GRAPH), ("shutdown", Right.ADMIN)):
        request = CallPeer(PEER, method, ("/robot",), right)
        layer = handle_program_call(setup.agent, PEER, method, ("/rosnode",))
        assert run_layer(layer, (request, Answered([1, "", 7]))) == [1, "", 7]
    stats = CallPeer(PEER, "getBusStats", ("/robot",), Right.GRAPH, parse=False)
    layer = handle_program_call(setup.agent, PEER, "getBusStats", ("/rosnode",))
    assert run_layer(layer, (stats, RawResponse(b"<malformed"))) == Encoded(b"<malformed")
    with pytest.raises(Fault, match="not supported"):
        run_layer(handle_program_call(setup.agent, PEER, "launch", ("/robot", "<launch/>")))


def test_the_topics_of_a_peer_get_an_egress_port(setup: AgentSetup) -> None:
    params = ("/robot", "/scan", [["TCPROS"]])
    remote = ListeningAddress(WireProtocol.TCPROS, "10.0.0.7", 6001)
    answer = run_layer(
        handle_program_call(setup.agent, PEER, "requestTopic", params),
        (
            CallPeer(PEER, "requestTopic", params, None),
            Answered([1, "ready", ["TCPROS", remote.host, remote.port]]),
        ),
        (OpenEgress(remote), PortOpened(8001)),
    )
    assert answer == [1, "ready", ["TCPROS", "127.0.0.1", 8001]]


@pytest.mark.parametrize(
    ("method", "value", "script", "expected"),
    [
        ("getUri", "http://x:1/", [(OpenEgress(PEER), PortOpened(8000))], "http://127.0.0.1:8000/"),
        ("getMasterUri", "http://x:1/", [], MASTER_URI),
        ("getBusInfo", [[1], [2, "/x", "o"]], [], [[1], [2, "/x", "o"]]),
        ("getBusInfo", 7, [], 7),
        (
            "getBusInfo",
            [[1, PEER.uri, "i", "TCPROS"], [2, PEER.uri, "i", "TCPROS"], [3, "odd", "i"]],
            [(OpenEgress(PEER), PortOpened(8000))],
            [[1, EGRESS_URI, "i", "TCPROS"], [2, EGRESS_URI, "i", "TCPROS"], [3, "odd", "i"]],
        ),
    ],
)
def test_answers_of_a_peer_name_egress_ports(
    setup: AgentSetup, method: str, value: object, script: list[tuple[OpenEgress, Event]], expected: object
) -> None:
    request = CallPeer(PEER, method, ("/robot",), Right.GRAPH)
    layer = handle_program_call(setup.agent, PEER, method, ("/robot",))
    assert run_layer(layer, (request, Answered([1, "", value])), *script) == [1, "", expected]


def test_bus_info_of_a_peer_names_this_identity_as_lookups_do(setup: AgentSetup) -> None:
    outside = setup.agent.endpoints.add_ingress(SLAVE, 7000)
    layer = handle_program_call(setup.agent, PEER, "getBusInfo", ("/robot",))
    request = CallPeer(PEER, "getBusInfo", ("/robot",), Right.GRAPH)
    answer = run_layer(layer, (request, Answered([1, "", [[1, outside.uri, "i"]]])))
    assert answer == [1, "", [[1, SLAVE.uri, "i"]]]


def test_a_peer_cannot_open_any_number_of_ports(setup: AgentSetup) -> None:
    uris = [f"http://10.0.0.7:{port}/" for port in range(1, 100)]
    layer = handle_program_call(setup.agent, PEER, "getBusInfo", ("/robot",))
    request = CallPeer(PEER, "getBusInfo", ("/robot",), Right.GRAPH)
    egress = [
        (OpenEgress(ListeningAddress(WireProtocol.HTTP, "10.0.0.7", port)), PortOpened(8000 + port))
        for port in range(1, 65)
    ]
    answer = run_layer(layer, (request, Answered([1, "", [[1, uri, "i"] for uri in uris]])), *egress)
    assert isinstance(answer, list)
    assert [entry[1] for entry in answer[2]][63:65] == ["http://127.0.0.1:8064/", uris[64]]


def test_refusals_of_a_peer_are_forwarded_and_no_answer_hangs_up(setup: AgentSetup) -> None:
    request = CallPeer(PEER, "getBusInfo", ("/robot",), Right.GRAPH)
    layer = handle_program_call(setup.agent, PEER, "getBusInfo", ("/robot",))
    assert run_layer(layer, (request, Answered([-1, "rossec: no", 0]))) == [-1, "rossec: no", 0]
    for event, error in ((NoAnswer("gone"), HangUp), (CommandDone(), UnexpectedEvent)):
        with pytest.raises(error):
            run_layer(handle_program_call(setup.agent, PEER, "getBusInfo", ("/robot",)), (request, event))


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
def test_an_unsuccessful_answer_carries_no_address(
    setup: AgentSetup, answer: object, expected: object
) -> None:
    """The program would connect to it in plaintext."""
    params = ("/robot", "/scan", [["TCPROS"]])
    request = CallPeer(PEER, "requestTopic", params, None)
    layer = handle_program_call(setup.agent, PEER, "requestTopic", params)
    assert run_layer(layer, (request, Answered(answer))) == expected
    call = CallProgram(SLAVE, "getPid", ("/master",))
    layer = peer_call(setup, "getPid", peer="/master")
    assert run_layer(layer, (call, Answered(answer))) == expected


@pytest.mark.parametrize("method", ["requestTopic", "getPid"])
def test_an_unparsed_answer_is_not_forwarded(setup: AgentSetup, method: str) -> None:
    params = ("/robot", "/scan", [["TCPROS"]])
    for layer in (
        handle_program_call(setup.agent, PEER, method, params),
        peer_call(setup, "getPid", *params[1:], peer="/master"),
    ):
        command = next(layer)
        assert isinstance(command, CallPeer | CallProgram)
        assert isinstance(command, CallProgram) or command.parse
        with pytest.raises(UnexpectedEvent):
            layer.send(RawResponse(b"anything"))
