"""Calls between programs and nodes of other domains: names are mapped both ways."""

from dataclasses import replace

import pytest

from ca.certificates import Identity
from ca.errors import NameRefused
from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.sidecar.core.layers import (
    Answered,
    AuthenticatePeer,
    CallPeer,
    CallProgram,
    Layer,
    ListeningAddress,
    OpenEgress,
    PeerAuthenticated,
    PortOpened,
    local_endpoint,
)
from rossec.sidecar.core.node_connections import handle_peer_call, handle_program_call
from tests.rossec.sidecar.agent_setup import AgentSetup, run_layer
from tests.support.openaccess import OpenAccess

SLAVE = local_endpoint(WireProtocol.HTTP, 5000)
PEER = ListeningAddress(WireProtocol.HTTP, "10.0.0.7", 6000)
EGRESS_URI = "http://127.0.0.1:8000/"
ALIAS = "/remote/hospital/scan"
AUTHENTICATE = AuthenticatePeer(PEER)


def foreigner(setup: AgentSetup) -> Identity:
    viewer = setup.identity("/viewer")
    return replace(viewer, name="/remote/hospital/viewer", certified="/viewer")


def foreign_call(setup: AgentSetup, method: str, *params: object) -> Layer[object]:
    """A call of the hospital's /viewer, which has every right here."""
    setup.agent = replace(setup.agent, access=OpenAccess())
    return handle_peer_call(setup.agent, SLAVE, foreigner(setup), method, ("/viewer", *params), b"", 0)


def test_a_peer_is_asked_for_a_topic_by_the_name_at_its_origin(setup: AgentSetup) -> None:
    request = CallPeer(PEER, "requestTopic", ("/robot", "/scan", [["TCPROS"]]), None)
    params = ("/robot", ALIAS, [["TCPROS"]])
    remote = ListeningAddress(WireProtocol.TCPROS, "10.0.0.7", 6001)
    answer = run_layer(
        handle_program_call(setup.agent, PEER, "requestTopic", params),
        (AUTHENTICATE, PeerAuthenticated(foreigner(setup))),
        (request, Answered([1, "ready", ["TCPROS", "10.0.0.7", 6001]], foreigner(setup))),
        (OpenEgress(remote), PortOpened(8001)),
    )
    assert answer == [1, "ready", ["TCPROS", "127.0.0.1", 8001]]
    with pytest.raises(NameRefused, match="names no origin"):
        run_layer(
            handle_program_call(setup.agent, PEER, "requestTopic", ("/robot", "/remote/x", [["TCPROS"]]))
        )


def test_a_peer_that_asks_for_an_alias_is_refused(setup: AgentSetup) -> None:
    answer = run_layer(
        handle_peer_call(
            setup.agent,
            SLAVE,
            setup.identity("/viewer"),
            "requestTopic",
            ("/viewer", ALIAS, [["TCPROS"]]),
            None,
            setup.site.now(),
        )
    )
    assert isinstance(answer, list)
    assert (answer[0], answer[2]) == (-1, [])
    assert "asked by the origin's name" in answer[1]


def test_a_program_reads_what_a_foreign_node_says_in_local_names(setup: AgentSetup) -> None:
    """As `rosnode info` needs it: topics and nodes by alias, publishers by loopback URIs."""
    rows = [
        [1, "http://10.0.0.9:6000/", "i", "TCPROS", "/scan", True],
        [2, "/display", "o", "TCPROS", "/scan", True],
        [3, "/remote/home/viewer", "o", "TCPROS", "/scan", True],
        [4, "home:/viewer", "o", "TCPROS", "/scan", True],
    ]
    peer = foreigner(setup)
    for method, value, script, expected in (
        (
            "getBusInfo",
            rows,
            ((OpenEgress(ListeningAddress(WireProtocol.HTTP, "10.0.0.9", 6000)), PortOpened(8000)),),
            [
                [1, EGRESS_URI, "i", "TCPROS", ALIAS, True],
                [2, "/remote/hospital/display", "o", "TCPROS", ALIAS, True],
                [4, "/viewer", "o", "TCPROS", ALIAS, True],
            ],
        ),
        ("getName", "/viewer", (), "/remote/hospital/viewer"),
        ("getPublications", [["/scan", "p/T"]], (), [[ALIAS, "p/T"]]),
        ("getPid", 7, (), 7),
    ):
        request = CallPeer(PEER, method, ("/robot",), Right.GRAPH)
        layer = handle_program_call(setup.agent, PEER, method, ("/rosnode",))
        assert run_layer(layer, (request, Answered([1, "", value], peer)), *script) == [1, "", expected]


def test_a_foreign_tool_is_known_to_the_program_by_its_alias(setup: AgentSetup) -> None:
    setup.agent.endpoints.add_egress(PEER, 8000)
    request = CallProgram(SLAVE, "getBusInfo", ("/remote/hospital/viewer",))
    rows = [
        [1, EGRESS_URI, "i", "TCPROS", "/scan", True],
        [2, EGRESS_URI, "i", "TCPROS", "/remote/clinic/scan", True],
    ]
    answer = run_layer(foreign_call(setup, "getBusInfo"), (request, Answered([1, "", rows])))
    assert answer == [1, "", [[1, PEER.uri, "i", "TCPROS", "/scan", True]]]


def test_statistics_that_are_not_parsed_are_not_sent_to_foreigners(setup: AgentSetup) -> None:
    assert run_layer(foreign_call(setup, "getBusStats")) == [1, "", [[], [], []]]


def test_an_anonymous_program_has_its_certified_name_towards_foreigners(setup: AgentSetup) -> None:
    robot = replace(setup.identity("/robot"), wildcard=True)
    setup.agent = replace(setup.agent, identity=robot)
    for method, params, caller in (
        ("requestTopic", (ALIAS, [["TCPROS"]]), "/robot"),
        ("requestTopic", ("/scan", [["TCPROS"]]), "/robot_1_2"),
        ("getPid", (), "/robot"),
    ):
        layer = handle_program_call(setup.agent, PEER, method, ("/robot_1_2", *params))
        command = next(layer)
        if command == AUTHENTICATE:
            command = layer.send(PeerAuthenticated(foreigner(setup)))
        assert isinstance(command, CallPeer)
        assert command.params[0] == caller
