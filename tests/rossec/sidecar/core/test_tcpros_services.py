"""Connection headers of services."""

import dataclasses

import pytest

from grants.errors import GrantError, GrantMissing
from grants.model import Restriction, Right
from rossec.errors import ConnectionHeaderRefused
from rossec.participant.authorized import memory_scope
from rossec.participant.handshakes import Fields
from rossec.sidecar.core.layers import ConnectPeer, ConnectProgram
from rossec.sidecar.core.node_connections import connect_to_peer
from tests.rossec.sidecar.agent_setup import AgentSetup, run_layer
from tests.rossec.sidecar.core.handshake import PEER, SERVICE, TOPIC_ENDPOINT, admit, arrived, no_key, proof


def test_services_are_admitted_in_both_directions(setup: AgentSetup) -> None:
    setup.site.grant("/viewer", Right.CALL, "/say")
    setup.site.grant("/robot", Right.PROVIDE, "/say")
    setup.agent = dataclasses.replace(setup.agent, access=setup.access("/robot"))
    authorized = SERVICE | proof(setup, "/viewer", Right.CALL, "/say")
    answer = {"callerid": b"/robot", "md5sum": b"0" * 32}
    admitted = run_layer(
        admit(setup, authorized, TOPIC_ENDPOINT),
        (ConnectProgram(TOPIC_ENDPOINT, SERVICE), arrived(setup, answer)),
    )
    assert admitted.service
    provided = answer | proof(setup, "/robot", Right.PROVIDE, "/say")
    assert admitted.answer == provided

    viewer = AgentSetup(setup.site, "/viewer")
    now = setup.site.now()
    admitted_there = run_layer(
        connect_to_peer(
            viewer.agent,
            PEER,
            SERVICE | {"callerid": b"/rosservice"},
            no_key,
            memory_scope("/viewer").child,
            now,
        ),
        (ConnectPeer(PEER, authorized), arrived(setup, provided, "/robot")),
    )
    assert admitted_there.answer == answer
    with pytest.raises(GrantMissing):
        run_layer(
            connect_to_peer(viewer.agent, PEER, SERVICE, no_key, memory_scope("/viewer").child, now),
            (ConnectPeer(PEER, authorized), arrived(setup, answer, "/robot")),
        )


@pytest.mark.parametrize("both", [{"topic": b"/secret"}, {"topic": b""}])
def test_a_header_for_both_topic_and_service_is_refused(setup: AgentSetup, both: Fields) -> None:
    """The call right must not read a topic: stock programs check the topic first."""
    setup.site.grant("/viewer", Right.CALL, "/say")
    authorized = SERVICE | proof(setup, "/viewer", Right.CALL, "/say")
    for fields in (authorized | both, {"callerid": b"/viewer"}):
        with pytest.raises(ConnectionHeaderRefused, match="for a topic or for a service"):
            run_layer(admit(setup, fields))
        with pytest.raises(ConnectionHeaderRefused, match="for a topic or for a service"):
            run_layer(
                connect_to_peer(
                    setup.agent, PEER, fields, no_key, memory_scope("/robot").child, setup.site.now()
                )
            )


def test_restrictions_on_services_are_refused(setup: AgentSetup) -> None:
    """In both directions: service headers hold no definition to apply them with."""
    limited = Restriction("std_srvs/SetBool", ("msg.data",))
    setup.site.grant("/viewer", Right.CALL, "/say", restriction=limited)
    authorized = SERVICE | proof(setup, "/viewer", Right.CALL, "/say")
    with pytest.raises(GrantError):
        run_layer(admit(setup, authorized, TOPIC_ENDPOINT))
    setup.site.grant("/viewer", Right.PROVIDE, "/do", restriction=limited)
    request = {"callerid": b"/robot", "service": b"/do", "md5sum": b"*"}
    answer = {"callerid": b"/viewer", **proof(setup, "/viewer", Right.PROVIDE, "/do")}
    layer = connect_to_peer(
        setup.agent, PEER, request, no_key, memory_scope("/robot").child, setup.site.now()
    )
    command = next(layer)
    assert isinstance(command, ConnectPeer)
    with pytest.raises(GrantError):
        layer.send(arrived(setup, answer, "/viewer"))
