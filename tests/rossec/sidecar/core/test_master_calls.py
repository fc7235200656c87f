"""What programs ask their master, and what the secured one is asked instead."""

from dataclasses import replace
from pathlib import Path

import pytest

from rossec.channel.opening import WireProtocol
from rossec.errors import HangUp
from rossec.master.api.dispatch import MasterApi
from rossec.master.state.registry import Registry
from rossec.participant.publisher_grace import GRACE
from rossec.ros.xmlrpc import Fault
from rossec.sidecar.core.commands import (
    AskLocal,
    AskMaster,
    OpenEgress,
    OpenIngress,
    Probe,
    Suspend,
)
from rossec.sidecar.core.endpoints import Endpoint, inside
from rossec.sidecar.core.events import Answered, CommandDone, NoAnswer, Opened, Passed
from rossec.sidecar.core.layers import UnexpectedEvent
from rossec.sidecar.core.master_calls import (
    MULTICALL_LIMIT,
    RULES,
    call,
    let_go,
    restore,
    resubscribe,
)
from tests.rossec.master.fakes import FakeStatements
from tests.rossec.sidecar.playbook import HOST, MASTER_URI, Stage, play
from tests.support.site import Site

OWN = "http://localhost:5000"  # as a program may spell it
SLAVE = inside(WireProtocol.HTTP, 5000)
OUTSIDE = f"http://{HOST}:7000/"
SERVICE = inside(WireProtocol.TCPROS, 5001)
PEER = Endpoint(WireProtocol.HTTP, "10.0.0.7", 6000)
OK = Answered([1, "done", 0])
ALIVE = (Probe(SLAVE), CommandDone())


def register(stage: Stage, *uris: str) -> object:
    imports = [(OpenEgress(PEER), Opened(8000)) for uri in uris if uri == PEER.uri]
    params = ("/robot", "/scan", "pkg/Type", OUTSIDE)
    return play(
        call(stage.tenant, "registerSubscriber", ("/robot", "/scan", "pkg/Type", OWN)),
        (OpenIngress(SLAVE), Opened(7000)),
        (AskMaster("registerSubscriber", params), Answered([1, "ok", list(uris)])),
        *imports,
    )


def test_a_program_registers_with_its_door_and_gets_doors(stage: Stage) -> None:
    assert register(stage, PEER.uri) == [1, "ok", ["http://127.0.0.1:8000/"]]


def test_its_own_uri_comes_back_byte_for_byte(stage: Stage) -> None:
    assert register(stage, OUTSIDE, "no uri") == [1, "ok", [OWN]]


def test_another_program_of_the_same_identity_is_met_through_the_channel(stage: Stage) -> None:
    """Its messages must pass the guard like everybody's."""
    stage.tenant.doors.opened_outside(inside(WireProtocol.HTTP, 5555), 7777)
    other = Endpoint(WireProtocol.HTTP, HOST, 7777)
    params = ("/robot", "/scan", "pkg/Type", OUTSIDE)
    answer = play(
        call(stage.tenant, "registerSubscriber", ("/robot", "/scan", "pkg/Type", OWN)),
        (OpenIngress(SLAVE), Opened(7000)),
        (AskMaster("registerSubscriber", params), Answered([1, "ok", [other.uri]])),
        (OpenEgress(other), Opened(8000)),
    )
    assert answer == [1, "ok", ["http://127.0.0.1:8000/"]]


def test_a_service_is_exported_with_the_slave_api(stage: Stage) -> None:
    answer = play(
        call(stage.tenant, "registerService", ("/robot", "/say", "rosrpc://127.0.0.1:5001", OWN)),
        (OpenIngress(SLAVE), Opened(7000)),
        (OpenIngress(SERVICE), Opened(7001)),
        (AskMaster("registerService", ("/robot", "/say", f"rosrpc://{HOST}:7001", OUTSIDE)), OK),
    )
    assert answer == [1, "done", 0]


def test_what_was_registered_is_unregistered_and_forgotten(stage: Stage) -> None:
    register(stage)
    play(
        call(stage.tenant, "unregisterSubscriber", ("/robot", "/scan", OWN)),
        (OpenIngress(SLAVE), Opened(7000)),
        (AskMaster("unregisterSubscriber", ("/robot", "/scan", OUTSIDE)), OK),
    )
    assert play(restore(stage.tenant), ALIVE) is None


def test_a_successor_keeps_its_registration(stage: Stage) -> None:
    """The old instance that the master ends says goodbye after the new one has registered."""
    register(stage)
    elsewhere = inside(WireProtocol.HTTP, 5999)
    play(
        call(stage.tenant, "unregisterSubscriber", ("/robot", "/scan", elsewhere.uri)),
        (OpenIngress(elsewhere), Opened(7999)),
        (AskMaster("unregisterSubscriber", ("/robot", "/scan", f"http://{HOST}:7999/")), OK),
    )
    params = ("/robot", "/scan", "pkg/Type", OUTSIDE)
    ask = AskMaster("registerSubscriber", params)
    assert play(restore(stage.tenant), ALIVE, (ask, Answered([-1, "", []]))) is None


def test_a_service_is_forgotten_by_its_own_address(stage: Stage) -> None:
    outside = f"rosrpc://{HOST}:7001"
    params = ("/robot", "/say", outside, OUTSIDE)
    play(
        call(stage.tenant, "registerService", ("/robot", "/say", SERVICE.uri, OWN)),
        (OpenIngress(SLAVE), Opened(7000)),
        (OpenIngress(SERVICE), Opened(7001)),
        (AskMaster("registerService", params), OK),
    )
    other = inside(WireProtocol.TCPROS, 5002)
    play(
        call(stage.tenant, "unregisterService", ("/robot", "/say", other.uri)),
        (OpenIngress(other), Opened(7002)),
        (AskMaster("unregisterService", ("/robot", "/say", f"rosrpc://{HOST}:7002")), OK),
    )
    play(restore(stage.tenant), ALIVE, (AskMaster("registerService", params), OK))
    play(
        call(stage.tenant, "unregisterService", ("/robot", "/say", SERVICE.uri)),
        (OpenIngress(SERVICE), Opened(7001)),
        (AskMaster("unregisterService", params[:3]), OK),
    )
    assert play(restore(stage.tenant), ALIVE) is None


def test_who_takes_a_dead_programs_port_has_none_of_its_registrations(tmp_path: Path) -> None:
    stage = Stage(Site(tmp_path / "site"), wildcard=True)
    register(stage)
    params = ("/robot_2", "/word", "pkg/Type", OUTSIDE)
    play(
        call(stage.tenant, "registerPublisher", ("/robot_2", "/word", "pkg/Type", OWN)),
        (OpenIngress(SLAVE), Opened(7000)),
        (AskMaster("registerPublisher", params), OK),
    )
    play(restore(stage.tenant), ALIVE, (AskMaster("registerPublisher", params), OK))


def test_a_restarted_master_hears_of_everything_again(stage: Stage) -> None:
    register(stage)
    params = ("/robot", "/scan", "pkg/Type", OUTSIDE)
    update = ("/master", "/scan", ["http://127.0.0.1:8000/"])
    play(
        restore(stage.tenant),
        ALIVE,
        (AskMaster("registerSubscriber", params), Answered([1, "ok", [PEER.uri]])),
        (OpenEgress(PEER), Opened(8000)),
        (AskLocal(SLAVE, "publisherUpdate", update), NoAnswer("gone", dead=True)),
        (Suspend(SLAVE), CommandDone()),
    )
    assert play(restore(stage.tenant)) is None


def test_a_dead_program_is_left_out(stage: Stage) -> None:
    register(stage)
    gone = (Probe(SLAVE), NoAnswer("refused", dead=True)), (Suspend(SLAVE), CommandDone())
    assert play(restore(stage.tenant), *gone) is None
    assert play(restore(stage.tenant)) is None


def test_restoring_ends_with_the_connection_and_bears_refusals(stage: Stage) -> None:
    register(stage)
    ask = AskMaster("registerSubscriber", ("/robot", "/scan", "pkg/Type", OUTSIDE))
    play(restore(stage.tenant), ALIVE, (ask, Answered([-1, "no right", []])))
    with pytest.raises(HangUp):
        play(restore(stage.tenant), ALIVE, (ask, NoAnswer("cut")))


def test_a_lost_topic_has_its_publishers_named_again(stage: Stage) -> None:
    register(stage)
    play(
        resubscribe(stage.tenant, "/scan"),
        (
            AskMaster("registerSubscriber", ("/robot", "/scan", "pkg/Type", OUTSIDE)),
            Answered([1, "ok", [PEER.uri]]),
        ),
        (OpenEgress(PEER), Opened(8000)),
        (
            AskLocal(SLAVE, "publisherUpdate", ("/master", "/scan", ["http://127.0.0.1:8000/"])),
            Answered([1, "", 0]),
        ),
    )
    assert play(resubscribe(stage.tenant, "/unknown")) is None


def named(*uris: str) -> tuple[AskLocal, Answered]:
    return AskLocal(SLAVE, "publisherUpdate", ("/master", "/scan", [*uris])), Answered([1, "", 0])


def test_a_publisher_that_a_new_master_does_not_name_yet_is_named_for_a_while(stage: Stage) -> None:
    register(stage, PEER.uri)
    inside_uri = "http://127.0.0.1:8000/"
    again = AskMaster("registerSubscriber", ("/robot", "/scan", "pkg/Type", OUTSIDE))
    stage.tenant.named.session_opened()
    play(
        restore(stage.tenant),
        ALIVE,
        (again, Answered([1, "ok", []])),
        (OpenEgress(PEER), Opened(8000)),
        named(inside_uri),
    )
    assert play(let_go(stage.tenant)) is None
    stage.time += GRACE
    play(let_go(stage.tenant), named())
    assert play(let_go(stage.tenant)) is None


def test_a_program_may_not_register_under_another_name(stage: Stage) -> None:
    answer = play(call(stage.tenant, "registerPublisher", ("/victim", "/cmd_vel", "pkg/Type", OWN)))
    assert isinstance(answer, list)
    assert answer[0] == -1
    assert "calls itself /victim: start it with __name:=robot" in answer[1]


def test_a_door_cannot_be_registered_as_ones_own(stage: Stage) -> None:
    """Or the sidecar would carry a peer's calls to another peer (L7)."""
    stage.tenant.doors.opened_inside(PEER, 8000)
    uri = "http://127.0.0.1:8000/"
    answer = play(call(stage.tenant, "registerPublisher", ("/robot", "/x", "pkg/Type", uri)))
    assert answer == [-1, "rossec: this address is not the program's own", 0]


def test_cleanup_gives_back_what_lookups_answered(stage: Stage) -> None:
    """`rosnode cleanup` speaks for the dead node; the master decides whether it may."""
    stage.tenant.doors.opened_inside(PEER, 8000)
    play(
        call(stage.tenant, "unregisterPublisher", ("/dead", "/x", "http://127.0.0.1:8000/")),
        (AskMaster("unregisterPublisher", ("/dead", "/x", PEER.uri)), OK),
    )


def test_tools_speak_under_a_certified_name_with_names_resolved(stage: Stage) -> None:
    play(
        call(stage.tenant, "setParam", ("/there/tool", "speed", 7)),
        (AskMaster("setParam", ("/robot", "/there/speed", 7)), OK),
    )
    play(
        call(stage.tenant, "setParam", ("/there/tool", 3, 7)),
        (AskMaster("setParam", ("/robot", 3, 7)), OK),
    )


def test_lookups(stage: Stage) -> None:
    tenant = stage.tenant
    answer = play(
        call(tenant, "lookupNode", ("/robot", "/viewer")),
        (AskMaster("lookupNode", ("/robot", "/viewer")), Answered([1, "node api", PEER.uri])),
        (OpenEgress(PEER, probe=True), Opened(8000)),
    )
    assert answer == [1, "node api", "http://127.0.0.1:8000/"]
    remote = Endpoint(WireProtocol.TCPROS, "10.0.0.7", 6001)
    answer = play(
        call(tenant, "lookupService", ("/robot", "/say")),
        (AskMaster("lookupService", ("/robot", "/say")), Answered([1, "x", remote.uri])),
        (OpenEgress(remote), Opened(8001)),
    )
    assert answer == [1, "rosrpc URI: [rosrpc://127.0.0.1:8001]", "rosrpc://127.0.0.1:8001"]
    for method in ("lookupNode", "lookupService"):
        ask = AskMaster(method, ("/robot", "/x"))
        assert play(call(tenant, method, ("/robot", "/x")), (ask, Answered([1, "", "nonsense"])))


def test_a_node_of_the_same_identity_is_met_directly(stage: Stage) -> None:
    register(stage)
    answer = play(
        call(stage.tenant, "lookupNode", ("/robot", "/robot")),
        (AskMaster("lookupNode", ("/robot", "/robot")), Answered([1, "node api", OUTSIDE])),
    )
    assert answer == [1, "node api", OWN]


def test_the_masters_own_address_is_the_loopback_one(stage: Stage) -> None:
    ask = AskMaster("getUri", ("/robot",))
    answer = play(call(stage.tenant, "getUri", ("/robot",)), (ask, Answered([1, "", "http://m/"])))
    assert answer == [1, "", MASTER_URI]


def test_elements_of_a_multicall_are_calls_of_their_own(stage: Stage) -> None:
    elements: list[object] = [
        {"methodName": "setParam", "params": ["/robot", "/a", 1]},
        {"methodName": "rossec.updateRevocations", "params": ["/robot", b""]},
        {"methodName": "system.multicall", "params": [[]]},
        {"methodName": "getParam", "params": ["/robot", "/b"]},
        "nonsense",
    ]
    answers = play(
        call(stage.tenant, "system.multicall", (elements,)),
        (AskMaster("setParam", ("/robot", "/a", 1)), OK),
        (AskMaster("getParam", ("/robot", "/b")), Fault(1, "broken")),
    )
    assert isinstance(answers, list)
    assert answers[0] == [[1, "done", 0]]
    assert [set(answer) for answer in answers[1:]] == [{"faultCode", "faultString"}] * 4


@pytest.mark.parametrize("params", [(), (7,), ([{}] * (MULTICALL_LIMIT + 1),)])
def test_a_multicall_is_one_bounded_list(stage: Stage, params: tuple[object, ...]) -> None:
    with pytest.raises(Fault):
        play(call(stage.tenant, "system.multicall", params))


@pytest.mark.parametrize("method", ["rossec.presentGrants", "launch", "__init__", ""])
def test_what_is_no_call_of_a_program_is_not_passed_on(stage: Stage, method: str) -> None:
    assert method not in RULES
    with pytest.raises(Fault, match="is not supported"):
        play(call(stage.tenant, method, ("/robot",)))


def test_odd_parameters_are_left_to_the_master(stage: Stage) -> None:
    tenant = stage.tenant
    assert play(call(tenant, "getPid", ())) == [-1, "missing required caller_id parameter", -1]
    assert play(call(tenant, "getUri", (7,))) == [-1, "caller_id must be a string", ""]
    odd = ("/robot", "/x", "pkg/Type", 7)
    ask = AskMaster("registerPublisher", odd)
    assert play(call(tenant, "registerPublisher", odd), (ask, Answered([-1, "no URI", []])))
    short = AskMaster("registerPublisher", ("/robot",))
    assert play(call(tenant, "registerPublisher", ("/robot",)), (short, Answered([-1, "", 0])))


def test_refusals_have_the_masters_values() -> None:
    """The sidecar answers itself where a call names nobody, and must say what the master says."""
    api = MasterApi(Registry(), FakeStatements(), name="/master", uri="http://m:1/", pid=1)
    assert {name: rule.default for name, rule in RULES.items()} == {
        name: api.methods[name].default for name in RULES
    }


FOUND = [1, "Found", "x"]
NOT_FOUND = Answered([-1, "Cannot find parameter [x] in an upwards search", ""])


def test_a_search_begins_where_the_asker_is(stage: Stage) -> None:
    """Under the certified name the master would search from another namespace."""

    def looks(place: str) -> AskMaster:
        return AskMaster("searchParam", ("/robot", place))

    for key, rest in (("x", ""), ("x/y", "/y")):
        layer = call(stage.tenant, "searchParam", ("/ns/rosparam-17", key))
        answer = play(
            layer,
            (looks("/ns/rosparam-17/x"), NOT_FOUND),
            (looks("/ns/x"), Answered([1, "Found [/ns/x]", "/ns/x"])),
        )
        assert answer == [1, f"Found [/ns/x{rest}]", f"/ns/x{rest}"]
    layer = call(stage.tenant, "searchParam", ("/tool", "x"))
    nowhere = play(layer, (looks("/tool/x"), NOT_FOUND), (looks("/x"), NOT_FOUND))
    assert nowhere == [-1, "Cannot find parameter [x] in an upwards search", ""]
    layer = call(stage.tenant, "searchParam", ("/tool", "x"))
    refused = [-1, "rossec: revoked", 0]
    assert play(layer, (looks("/tool/x"), Answered(refused))) == refused


def test_a_search_under_ones_own_name_is_the_masters(stage: Stage) -> None:
    for params in (("/robot", "x"), ("/tool", "/x"), ("/tool", "~x")):
        asked = AskMaster("searchParam", ("/robot", params[1]))
        assert play(call(stage.tenant, "searchParam", params), (asked, Answered(FOUND))) == FOUND


def test_a_master_out_of_reach_or_out_of_its_mind_ends_the_connection(stage: Stage) -> None:
    ask = AskMaster("getPid", ("/robot",))
    for event in (NoAnswer("no answer"), Answered(7), Answered([1, "short"])):
        with pytest.raises(HangUp):
            play(call(stage.tenant, "getPid", ("/robot",)), (ask, event))
    with pytest.raises(UnexpectedEvent):
        play(call(stage.tenant, "getPid", ("/robot",)), (ask, Passed(b"")))
    with pytest.raises(UnexpectedEvent):
        play(
            call(stage.tenant, "registerPublisher", ("/robot", "/x", "pkg/Type", OWN)),
            (OpenIngress(SLAVE), CommandDone()),
        )


def test_an_anonymous_program_uses_the_wildcard(stage: Stage) -> None:
    anonymous = Stage(stage.site, "/rviz", wildcard=True)
    params = ("/rviz_12_34", "/x", "pkg/Type", OWN)
    play(
        call(anonymous.tenant, "registerPublisher", params),
        (OpenIngress(SLAVE), Opened(7000)),
        (AskMaster("registerPublisher", (*params[:3], OUTSIDE)), Answered([1, "", []])),
    )
    assert replace(anonymous.tenant).name_for("/rvizx") == "/rviz"
