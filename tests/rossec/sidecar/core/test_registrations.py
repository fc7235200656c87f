"""Stored registrations: made again, removed, and updated."""

from collections.abc import Callable
from pathlib import Path

import pytest

from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.errors import HangUp
from rossec.participant.registrations import GRACE, MAX_REFUSED
from rossec.sidecar.core.layers import (
    Answered,
    CallMaster,
    CallProgram,
    CommandDone,
    NoAnswer,
    OpenEgress,
    OpenIngress,
    PortOpened,
    Probe,
    Suspend,
    local_endpoint,
)
from rossec.sidecar.core.master_calls import (
    drop_expired_publishers,
    handle_call,
    restore,
    resubscribe,
    rights_changed,
)
from tests.rossec.sidecar.agent_setup import HOST, AgentSetup, run_layer
from tests.rossec.sidecar.core.registering import INGRESS_URI, OK, OWN_URI, PEER, SERVICE, SLAVE, register
from tests.support.site import Site

ALIVE = (Probe(SLAVE), CommandDone())


def test_an_unregistered_topic_is_not_restored(setup: AgentSetup) -> None:
    register(setup)
    run_layer(
        handle_call(setup.agent, "unregisterSubscriber", ("/robot", "/scan", OWN_URI)),
        (CallMaster("unregisterSubscriber", ("/robot", "/scan", INGRESS_URI)), OK),
    )
    assert run_layer(restore(setup.agent, has()), ALIVE) is None


def test_a_new_program_of_the_same_name_keeps_its_registration(setup: AgentSetup) -> None:
    """The old instance that the master shuts down unregisters after the new one has registered."""
    register(setup)
    other_api = local_endpoint(WireProtocol.HTTP, 5999)
    run_layer(
        handle_call(setup.agent, "unregisterSubscriber", ("/robot", "/scan", other_api.uri)),
        (CallMaster("unregisterSubscriber", ("/robot", "/scan", f"http://{HOST}:5999/")), OK),
    )
    params = ("/robot", "/scan", "pkg/Type", INGRESS_URI)
    request = CallMaster("registerSubscriber", params)
    assert run_layer(restore(setup.agent, has()), ALIVE, (request, Answered([-1, "", []]))) is None


def test_a_service_is_unregistered_by_its_own_address(setup: AgentSetup) -> None:
    outside = f"rosrpc://{HOST}:7001"
    params = ("/robot", "/say", outside, INGRESS_URI)
    run_layer(
        handle_call(setup.agent, "registerService", ("/robot", "/say", SERVICE.uri, OWN_URI)),
        (OpenIngress(SLAVE), PortOpened(7000)),
        (OpenIngress(SERVICE), PortOpened(7001)),
        (CallMaster("registerService", params), OK),
    )
    other = local_endpoint(WireProtocol.TCPROS, 5002)
    run_layer(
        handle_call(setup.agent, "unregisterService", ("/robot", "/say", other.uri)),
        (CallMaster("unregisterService", ("/robot", "/say", f"rosrpc://{HOST}:5002")), OK),
    )
    run_layer(restore(setup.agent, has()), ALIVE, (CallMaster("registerService", params), OK))
    run_layer(
        handle_call(setup.agent, "unregisterService", ("/robot", "/say", SERVICE.uri)),
        (CallMaster("unregisterService", params[:3]), OK),
    )
    assert run_layer(restore(setup.agent, has()), ALIVE) is None


def test_a_program_on_a_reused_port_has_none_of_the_old_registrations(tmp_path: Path) -> None:
    setup = AgentSetup(Site(tmp_path / "site"), wildcard=True)
    register(setup)
    params = ("/robot_2", "/word", "pkg/Type", INGRESS_URI)
    run_layer(
        handle_call(setup.agent, "registerPublisher", ("/robot_2", "/word", "pkg/Type", OWN_URI)),
        (OpenIngress(SLAVE), PortOpened(7000)),
        (CallMaster("registerPublisher", params), OK),
    )
    run_layer(restore(setup.agent, has()), ALIVE, (CallMaster("registerPublisher", params), OK))


def test_registrations_are_made_again_with_a_restarted_master(setup: AgentSetup) -> None:
    register(setup)
    params = ("/robot", "/scan", "pkg/Type", INGRESS_URI)
    update = ("/master", "/scan", ["http://127.0.0.1:8000/"])
    run_layer(
        restore(setup.agent, has()),
        ALIVE,
        (CallMaster("registerSubscriber", params), Answered([1, "ok", [PEER.uri]])),
        (OpenEgress(PEER), PortOpened(8000)),
        (CallProgram(SLAVE, "publisherUpdate", update), NoAnswer("gone", dead=True)),
        (Suspend(SLAVE), CommandDone()),
    )
    assert run_layer(restore(setup.agent, has())) is None


def test_a_dead_program_is_not_restored(setup: AgentSetup) -> None:
    register(setup)
    ended = (Probe(SLAVE), NoAnswer("refused", dead=True)), (Suspend(SLAVE), CommandDone())
    assert run_layer(restore(setup.agent, has()), *ended) is None
    assert run_layer(restore(setup.agent, has())) is None


def test_restoring_continues_after_refusals_and_stops_without_answer(setup: AgentSetup) -> None:
    register(setup)
    request = CallMaster("registerSubscriber", ("/robot", "/scan", "pkg/Type", INGRESS_URI))
    run_layer(restore(setup.agent, has()), ALIVE, (request, Answered([-1, "no right", []])))
    with pytest.raises(HangUp):
        run_layer(restore(setup.agent, has()), ALIVE, (request, NoAnswer("closed")))


def test_resubscribing_sends_the_publishers_again(setup: AgentSetup) -> None:
    register(setup)
    run_layer(
        resubscribe(setup.agent, "/scan"),
        (
            CallMaster("registerSubscriber", ("/robot", "/scan", "pkg/Type", INGRESS_URI)),
            Answered([1, "ok", [PEER.uri]]),
        ),
        (OpenEgress(PEER), PortOpened(8000)),
        (
            CallProgram(SLAVE, "publisherUpdate", ("/master", "/scan", ["http://127.0.0.1:8000/"])),
            Answered([1, "", 0]),
        ),
    )
    assert run_layer(resubscribe(setup.agent, "/unknown")) is None


def publisher_update(*uris: str) -> tuple[CallProgram, Answered]:
    return CallProgram(SLAVE, "publisherUpdate", ("/master", "/scan", [*uris])), Answered([1, "", 0])


def test_a_publisher_missing_at_a_new_master_is_kept_for_a_grace_period(setup: AgentSetup) -> None:
    register(setup, PEER.uri)
    inside_uri = "http://127.0.0.1:8000/"
    register_again = CallMaster("registerSubscriber", ("/robot", "/scan", "pkg/Type", INGRESS_URI))
    setup.agent.publisher_grace.session_opened()
    run_layer(
        restore(setup.agent, has()),
        ALIVE,
        (register_again, Answered([1, "ok", []])),
        (OpenEgress(PEER), PortOpened(8000)),
        publisher_update(inside_uri),
    )
    assert run_layer(drop_expired_publishers(setup.agent)) is None
    setup.time += GRACE
    run_layer(drop_expired_publishers(setup.agent), publisher_update())
    assert run_layer(drop_expired_publishers(setup.agent)) is None


def has(*rights: tuple[Right, str]) -> Callable[[Right, str], bool]:
    return lambda right, name: (right, name) in rights


PUBLISHER = ("/robot", "/pose", "pkg/Type", INGRESS_URI)
REFUSED = Answered([-1, "rossec: /robot needs the right publish on /pose", []])


def refuse(setup: AgentSetup, params: tuple[str, ...] = PUBLISHER, answer: Answered = REFUSED) -> None:
    run_layer(
        handle_call(setup.agent, "registerPublisher", (*params[:3], OWN_URI)),
        (OpenIngress(SLAVE), PortOpened(7000)),
        (CallMaster("registerPublisher", params), answer),
    )


def test_a_refused_registration_is_made_again_with_the_right(setup: AgentSetup) -> None:
    refuse(setup)
    assert run_layer(restore(setup.agent, has()), ALIVE) is None, "a restarted master would refuse it"
    assert run_layer(rights_changed(setup.agent, has())) is None
    may = has((Right.PUBLISH, "/pose"))
    again = CallMaster("registerPublisher", PUBLISHER)
    run_layer(rights_changed(setup.agent, may), ALIVE, (again, REFUSED))
    run_layer(restore(setup.agent, may), ALIVE, (again, REFUSED))
    run_layer(rights_changed(setup.agent, may), ALIVE, (again, Answered([1, "", []])))
    assert setup.agent.programs[SLAVE].registrations.refused() == []
    run_layer(restore(setup.agent, has()), ALIVE, (again, Answered([1, "", []])))


@pytest.mark.parametrize(
    ("topic", "reason", "code"),
    [("/rosout", "no grant for it", 1), ("/rosout", "expired", -1), ("/pose", "no grant", -1)],
)
def test_what_a_program_works_without_succeeds_for_it(
    setup: AgentSetup, topic: str, reason: str, code: int
) -> None:
    """rospy calls its refusal fatal. It is made again with the right, as any other."""
    params = ("/robot", topic, "pkg/Type", INGRESS_URI)
    status = f"rossec: /robot needs the right publish on {topic}: {reason}"
    answer = run_layer(
        handle_call(setup.agent, "registerPublisher", (*params[:3], OWN_URI)),
        (OpenIngress(SLAVE), PortOpened(7000)),
        (CallMaster("registerPublisher", params), Answered([-1, status, []])),
    )
    assert answer == [code, status, []]
    refused = setup.agent.programs[SLAVE].registrations.refused()
    assert refused == [("registerPublisher", params)]


def test_a_registration_that_ended_with_its_right_is_made_again(setup: AgentSetup) -> None:
    register(setup)
    layer = rights_changed(setup.agent, has((Right.SUBSCRIBE, "/scan")))
    params = ("/robot", "/scan", "pkg/Type", INGRESS_URI)
    run_layer(layer, ALIVE, (CallMaster("registerSubscriber", params), Answered([-1, "", []])))


def test_a_program_that_ended_is_not_registered_with_a_new_right(setup: AgentSetup) -> None:
    refuse(setup)
    layer = rights_changed(setup.agent, has((Right.PUBLISH, "/pose")))
    run_layer(layer, (Probe(SLAVE), NoAnswer("gone", dead=True)), (Suspend(SLAVE), CommandDone()))
    assert setup.agent.programs == {}


def test_a_refused_registration_that_is_undone_is_not_made_again(setup: AgentSetup) -> None:
    refuse(setup)
    run_layer(
        handle_call(setup.agent, "unregisterPublisher", ("/robot", "/pose", OWN_URI)),
        (CallMaster("unregisterPublisher", ("/robot", "/pose", INGRESS_URI)), OK),
    )
    assert list(setup.agent.programs[SLAVE].registrations) == []


def test_refusals_are_bounded_and_those_of_the_stock_master_are_not_stored(setup: AgentSetup) -> None:
    refuse(setup, answer=Answered([-1, "ERROR: parameter [topic] contains illegal chars", 0]))
    assert list(setup.agent.programs[SLAVE].registrations) == []
    for number in range(MAX_REFUSED + 1):
        refuse(setup, ("/robot", f"/pose{number}", "pkg/Type", INGRESS_URI))
    assert len(setup.agent.programs[SLAVE].registrations.refused()) == MAX_REFUSED
