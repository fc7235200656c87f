"""Master API calls of programs, and the rewritten calls to the secured master."""

from dataclasses import replace

import pytest

from rossec.channel.opening import WireProtocol
from rossec.errors import HangUp
from rossec.master.state.registry import Registry
from rossec.ros.xmlrpc import Fault
from rossec.sidecar.core.layers import (
    Answered,
    CallMaster,
    CommandDone,
    ListeningAddress,
    NoAnswer,
    OpenEgress,
    OpenIngress,
    PortOpened,
    RawResponse,
    UnexpectedEvent,
    local_endpoint,
)
from rossec.sidecar.core.master_calls import MULTICALL_LIMIT, RULES, handle_call
from tests.rossec.master.fakes import FakeStatements, master_api
from tests.rossec.sidecar.agent_setup import HOST, MASTER_URI, AgentSetup, run_layer
from tests.rossec.sidecar.core.registering import INGRESS_URI, OK, OWN_URI, PEER, SERVICE, SLAVE, register


def test_a_registration_is_rewritten_in_both_directions(setup: AgentSetup) -> None:
    assert register(setup, PEER.uri) == [1, "ok", ["http://127.0.0.1:8000/"]]


def test_the_programs_own_uri_is_returned_byte_for_byte(setup: AgentSetup) -> None:
    assert register(setup, INGRESS_URI, "no uri") == [1, "ok", [OWN_URI]]


def test_another_program_of_the_same_identity_is_reached_through_the_channel(setup: AgentSetup) -> None:
    """Its messages must pass the guard too."""
    setup.agent.endpoints.add_ingress(local_endpoint(WireProtocol.HTTP, 5555), 7777)
    other = ListeningAddress(WireProtocol.HTTP, HOST, 7777)
    params = ("/robot", "/scan", "pkg/Type", INGRESS_URI)
    answer = run_layer(
        handle_call(setup.agent, "registerSubscriber", ("/robot", "/scan", "pkg/Type", OWN_URI)),
        (OpenIngress(SLAVE), PortOpened(7000)),
        (CallMaster("registerSubscriber", params), Answered([1, "ok", [other.uri]])),
        (OpenEgress(other), PortOpened(8000)),
    )
    assert answer == [1, "ok", ["http://127.0.0.1:8000/"]]


def test_a_service_is_registered_with_the_slave_api(setup: AgentSetup) -> None:
    answer = run_layer(
        handle_call(setup.agent, "registerService", ("/robot", "/say", "rosrpc://127.0.0.1:5001", OWN_URI)),
        (OpenIngress(SLAVE), PortOpened(7000)),
        (OpenIngress(SERVICE), PortOpened(7001)),
        (CallMaster("registerService", ("/robot", "/say", f"rosrpc://{HOST}:7001", INGRESS_URI)), OK),
    )
    assert answer == [1, "done", 0]


def test_a_program_may_not_register_under_another_name(setup: AgentSetup) -> None:
    answer = run_layer(
        handle_call(setup.agent, "registerPublisher", ("/victim", "/cmd_vel", "pkg/Type", OWN_URI))
    )
    assert isinstance(answer, list)
    assert answer[0] == -1
    assert "calls itself /victim: start it with __name:=robot" in answer[1]


def test_an_egress_port_cannot_be_registered(setup: AgentSetup) -> None:
    """Or the sidecar would forward a peer's calls to another peer (L7)."""
    setup.agent.endpoints.add_egress(PEER, 8000)
    uri = "http://127.0.0.1:8000/"
    answer = run_layer(handle_call(setup.agent, "registerPublisher", ("/robot", "/x", "pkg/Type", uri)))
    assert answer == [-1, "rossec: this address is not the program's own", 0]


def test_cleanup_may_name_the_uris_of_lookups(setup: AgentSetup) -> None:
    """`rosnode cleanup` unregisters dead nodes; the master authorizes it."""
    setup.agent.endpoints.add_egress(PEER, 8000)
    run_layer(
        handle_call(setup.agent, "unregisterPublisher", ("/dead", "/x", "http://127.0.0.1:8000/")),
        (CallMaster("unregisterPublisher", ("/dead", "/x", PEER.uri)), OK),
    )


def test_calls_of_tools_have_a_certified_caller_id_and_resolved_names(setup: AgentSetup) -> None:
    run_layer(
        handle_call(setup.agent, "setParam", ("/there/tool", "speed", 7)),
        (CallMaster("setParam", ("/robot", "/there/speed", 7)), OK),
    )
    run_layer(
        handle_call(setup.agent, "setParam", ("/there/tool", 3, 7)),
        (CallMaster("setParam", ("/robot", 3, 7)), OK),
    )


def test_lookups_return_egress_uris(setup: AgentSetup) -> None:
    agent = setup.agent
    answer = run_layer(
        handle_call(agent, "lookupNode", ("/robot", "/viewer")),
        (CallMaster("lookupNode", ("/robot", "/viewer")), Answered([1, "node api", PEER.uri])),
        (OpenEgress(PEER, probe=True), PortOpened(8000)),
    )
    assert answer == [1, "node api", "http://127.0.0.1:8000/"]
    remote = ListeningAddress(WireProtocol.TCPROS, "10.0.0.7", 6001)
    answer = run_layer(
        handle_call(agent, "lookupService", ("/robot", "/say")),
        (CallMaster("lookupService", ("/robot", "/say")), Answered([1, "x", remote.uri])),
        (OpenEgress(remote), PortOpened(8001)),
    )
    assert answer == [1, "rosrpc URI: [rosrpc://127.0.0.1:8001]", "rosrpc://127.0.0.1:8001"]
    for method in ("lookupNode", "lookupService"):
        request = CallMaster(method, ("/robot", "/x"))
        assert run_layer(
            handle_call(agent, method, ("/robot", "/x")), (request, Answered([1, "", "nonsense"]))
        )


def test_a_node_of_the_same_identity_is_reached_directly(setup: AgentSetup) -> None:
    register(setup)
    answer = run_layer(
        handle_call(setup.agent, "lookupNode", ("/robot", "/robot")),
        (CallMaster("lookupNode", ("/robot", "/robot")), Answered([1, "node api", INGRESS_URI])),
    )
    assert answer == [1, "node api", OWN_URI]


def test_the_uri_of_the_master_is_the_loopback_one(setup: AgentSetup) -> None:
    request = CallMaster("getUri", ("/robot",))
    answer = run_layer(
        handle_call(setup.agent, "getUri", ("/robot",)), (request, Answered([1, "", "http://m/"]))
    )
    assert answer == [1, "", MASTER_URI]


def test_elements_of_a_multicall_are_handled_as_calls(setup: AgentSetup) -> None:
    elements: list[object] = [
        {"methodName": "setParam", "params": ["/robot", "/a", 1]},
        {"methodName": "rossec.updateRevocations", "params": ["/robot", b""]},
        {"methodName": "system.multicall", "params": [[]]},
        {"methodName": "getParam", "params": ["/robot", "/b"]},
        "nonsense",
    ]
    answers = run_layer(
        handle_call(setup.agent, "system.multicall", (elements,)),
        (CallMaster("setParam", ("/robot", "/a", 1)), OK),
        (CallMaster("getParam", ("/robot", "/b")), Fault(1, "broken")),
    )
    assert isinstance(answers, list)
    assert answers[0] == [[1, "done", 0]]
    assert [set(answer) for answer in answers[1:]] == [{"faultCode", "faultString"}] * 4


@pytest.mark.parametrize("params", [(), (7,), ([{}] * (MULTICALL_LIMIT + 1),)])
def test_a_multicall_is_one_bounded_list(setup: AgentSetup, params: tuple[object, ...]) -> None:
    with pytest.raises(Fault):
        run_layer(handle_call(setup.agent, "system.multicall", params))


@pytest.mark.parametrize("method", ["rossec.presentGrants", "launch", "__init__", ""])
def test_unknown_methods_are_not_forwarded(setup: AgentSetup, method: str) -> None:
    assert method not in RULES
    with pytest.raises(Fault, match="is not supported"):
        run_layer(handle_call(setup.agent, method, ("/robot",)))


def test_invalid_parameters_are_left_to_the_master(setup: AgentSetup) -> None:
    agent = setup.agent
    assert run_layer(handle_call(agent, "getPid", ())) == [-1, "missing required caller_id parameter", -1]
    assert run_layer(handle_call(agent, "getUri", (7,))) == [-1, "caller_id must be a string", ""]
    odd = ("/robot", "/x", "pkg/Type", 7)
    request = CallMaster("registerPublisher", odd)
    assert run_layer(handle_call(agent, "registerPublisher", odd), (request, Answered([-1, "no URI", []])))
    short = CallMaster("registerPublisher", ("/robot",))
    assert run_layer(handle_call(agent, "registerPublisher", ("/robot",)), (short, Answered([-1, "", 0])))


def test_refusals_have_the_default_values_of_the_master() -> None:
    """The sidecar itself answers calls without caller_id, with the values of the master."""
    api = master_api(Registry(), FakeStatements(), name="/master", uri="http://m:1/", pid=1)
    assert {name: rule.default for name, rule in RULES.items()} == {
        name: api.methods[name].default for name in RULES
    }


FOUND = [1, "Found", "x"]
NOT_FOUND = Answered([-1, "Cannot find parameter [x] in an upwards search", ""])


def test_a_search_starts_in_the_callers_namespace(setup: AgentSetup) -> None:
    """Under the certified name the master would search from another namespace."""

    def search(key: str) -> CallMaster:
        return CallMaster("searchParam", ("/robot", key))

    for name, rest in (("x", ""), ("x/y", "/y")):
        layer = handle_call(setup.agent, "searchParam", ("/ns/rosparam-17", name))
        answer = run_layer(
            layer,
            (search("/ns/rosparam-17/x"), NOT_FOUND),
            (search("/ns/x"), Answered([1, "Found [/ns/x]", "/ns/x"])),
        )
        assert answer == [1, f"Found [/ns/x{rest}]", f"/ns/x{rest}"]
    layer = handle_call(setup.agent, "searchParam", ("/tool", "x"))
    nowhere = run_layer(layer, (search("/tool/x"), NOT_FOUND), (search("/x"), NOT_FOUND))
    assert nowhere == [-1, "Cannot find parameter [x] in an upwards search", ""]
    layer = handle_call(setup.agent, "searchParam", ("/tool", "x"))
    refused = [-1, "rossec: revoked", 0]
    assert run_layer(layer, (search("/tool/x"), Answered(refused))) == refused


def test_a_search_under_the_certified_name_is_forwarded(setup: AgentSetup) -> None:
    for params in (("/robot", "x"), ("/tool", "/x"), ("/tool", "~x")):
        request = CallMaster("searchParam", ("/robot", params[1]))
        assert run_layer(handle_call(setup.agent, "searchParam", params), (request, Answered(FOUND))) == FOUND


def test_no_answer_or_an_invalid_one_of_the_master_closes_the_connection(setup: AgentSetup) -> None:
    request = CallMaster("getPid", ("/robot",))
    for event in (NoAnswer("no answer"), Answered(7), Answered([1, "short"])):
        with pytest.raises(HangUp):
            run_layer(handle_call(setup.agent, "getPid", ("/robot",)), (request, event))
    with pytest.raises(UnexpectedEvent):
        run_layer(handle_call(setup.agent, "getPid", ("/robot",)), (request, RawResponse(b"")))
    with pytest.raises(UnexpectedEvent):
        run_layer(
            handle_call(setup.agent, "registerPublisher", ("/robot", "/x", "pkg/Type", OWN_URI)),
            (OpenIngress(SLAVE), CommandDone()),
        )


def test_an_anonymous_program_uses_the_wildcard(setup: AgentSetup) -> None:
    anonymous = AgentSetup(setup.site, "/rviz", wildcard=True)
    params = ("/rviz_12_34", "/x", "pkg/Type", OWN_URI)
    run_layer(
        handle_call(anonymous.agent, "registerPublisher", params),
        (OpenIngress(SLAVE), PortOpened(7000)),
        (CallMaster("registerPublisher", (*params[:3], INGRESS_URI)), Answered([1, "", []])),
    )
    assert replace(anonymous.agent).name_for("/rvizx") == "/rviz"


@pytest.mark.parametrize("name", ["/remote/hospital/scan", "//remote/hospital/scan", "/remote/"])
def test_a_program_offers_nothing_below_remote(setup: AgentSetup, name: str) -> None:
    """The master is not called, so that a restart does not make the registration either."""
    calls: list[tuple[str, tuple[object, ...]]] = [
        ("registerPublisher", ("/robot", name, "pkg/Type", OWN_URI)),
        ("registerService", ("/robot", name, "rosrpc://robot.local:5000", OWN_URI)),
        ("setParam", ("/robot", name, 7)),
        ("deleteParam", ("/rosparam_12", name)),
    ]
    for method, params in calls:
        answer = run_layer(handle_call(setup.agent, method, params))
        assert isinstance(answer, list)
        assert answer[0] == -1
        assert "names below /remote are those of other masters" in answer[1]
        assert "take a name outside /remote" in answer[1]
    assert not setup.agent.programs


def test_a_program_subscribes_to_an_alias_by_its_local_name(setup: AgentSetup) -> None:
    alias = "/remote/hospital/scan"
    answer = run_layer(
        handle_call(setup.agent, "registerSubscriber", ("/robot", alias, "pkg/Type", OWN_URI)),
        (OpenIngress(SLAVE), PortOpened(7000)),
        (
            CallMaster("registerSubscriber", ("/robot", alias, "pkg/Type", INGRESS_URI)),
            Answered([1, "ok", [PEER.uri]]),
        ),
        (OpenEgress(PEER), PortOpened(8000)),
    )
    assert answer == [1, "ok", ["http://127.0.0.1:8000/"]]
