"""The policy table: default deny, and the attacks on the Master API that need only the cores."""

from typing import Any

import pytest

from grants.model import Right
from rossec.master.api.dispatch import MasterApi
from rossec.master.api.methods import CallDenied, Denied
from rossec.master.rights.access_rules import RULES, AccessControl, Caller, Refused, Scope, require
from rossec.master.state.registry import Registry
from tests.rossec.master.fakes import ALL, FakeStatements, anonymous, call_api, caller, everything

BUT_ADMIN = {"**": ALL & ~Right.ADMIN}
T = "std_msgs/String"
VICTIM_API, EVIL_API = "http://victim:1/", "http://evil:1/"


@pytest.fixture
def api() -> MasterApi:
    """A master at which the victim publishes, subscribes and provides."""
    api = MasterApi(Registry(), FakeStatements(), name="/master", uri="http://m:1/", pid=7)
    victim = everything("/victim")
    for call in (
        ("registerPublisher", "/victim", "/secret", T, VICTIM_API),
        ("registerSubscriber", "/victim", "/cmd_vel", T, VICTIM_API),
        ("registerService", "/victim", "/arm", "rosrpc://victim:2", VICTIM_API),
    ):
        assert ask(api, victim, *call)[0] == 1
    return api


def ask(api: MasterApi, who: Caller, method: str, *params: object) -> Any:
    return call_api(api, method, params, who, 0).answer


def test_every_method_has_a_rule_and_every_rule_a_method(api: MasterApi) -> None:
    assert set(api.methods) == set(RULES)


def test_every_rule_that_names_or_reaches_something_has_a_right() -> None:
    for rule in RULES.values():
        assert (rule.right is not None) == (rule.scope in (Scope.NAMED, Scope.TREE, Scope.MASTER))


def test_a_method_without_a_rule_is_refused() -> None:
    with pytest.raises(Refused, match="no rule"):
        AccessControl(Registry(), "/master").check("newMethod", everything("/a"), ("/a",))


@pytest.mark.parametrize(
    ("method", "params", "right"),
    [
        ("registerPublisher", ("/t", T, EVIL_API), "publish"),
        ("registerSubscriber", ("/t", T, EVIL_API), "subscribe"),
        ("registerService", ("/t", "rosrpc://evil:2", EVIL_API), "provide"),
        ("lookupService", ("/t",), "call"),
        ("getParam", ("/t",), "param-get"),
        ("hasParam", ("/t",), "param-get"),
        ("subscribeParam", (EVIL_API, "/t"), "param-get"),
        ("setParam", ("/t", 1), "param-set"),
        ("deleteParam", ("/t",), "param-set"),
    ],
)
def test_without_the_right_the_answer_says_which(
    api: MasterApi, method: str, params: tuple[object, ...], right: str
) -> None:
    code, status, default = ask(api, caller("/x"), method, "/x", *params)
    assert (code, default) == (-1, api.methods[method].default)
    assert status.startswith(f"rossec: /x needs the right {right} on /t: ")
    assert "ask the authority" in status


@pytest.mark.parametrize(
    ("method", "params", "right"),
    [
        ("registerPublisher", ("t", T, EVIL_API), Right.PUBLISH),
        ("registerSubscriber", ("~t", T, EVIL_API), Right.SUBSCRIBE),
        ("registerService", ("/x/t", "rosrpc://evil:2", EVIL_API), Right.PROVIDE),
    ],
)
def test_exactly_that_right_on_the_resolved_name_is_enough(
    api: MasterApi, method: str, params: tuple[str, ...], right: Right
) -> None:
    name = {"t": "/n/t", "~t": "/n/x/t"}.get(params[0], params[0])
    assert ask(api, caller("/n/x", {name: right}), method, "/n/x", *params)[0] == 1
    others = Right(255) & ~right
    assert ask(api, caller("/n/x", {name: others}), method, "/n/x", *params)[0] == -1


def test_m1_without_grants_the_graph_is_empty(api: MasterApi) -> None:
    eve = caller("/eve")
    assert ask(api, eve, "getSystemState", "/eve")[2] == [[], [], []]
    assert ask(api, eve, "getTopicTypes", "/eve")[2] == []
    assert ask(api, eve, "getPublishedTopics", "/eve", "")[2] == []
    assert ask(api, eve, "getParamNames", "/eve")[2] == []
    hidden = ask(api, eve, "lookupNode", "/eve", "/victim")
    absent = ask(api, eve, "lookupNode", "/eve", "/nobody")
    assert hidden == [-1, "unknown node [/victim]", ""]
    assert absent == [-1, "unknown node [/nobody]", ""]
    refused = ask(api, eve, "lookupService", "/eve", "/arm")
    assert refused[1] == ask(api, eve, "lookupService", "/eve", "/none")[1].replace("/none", "/arm")


@pytest.mark.parametrize("right", [Right.PUBLISH, Right.SUBSCRIBE, Right.CALL, Right.GRAPH])
def test_m1_a_covered_name_is_shown_and_no_other(api: MasterApi, right: Right) -> None:
    bob = caller("/bob", {"/secret": right})
    assert ask(api, bob, "getSystemState", "/bob")[2] == [[["/secret", ["/victim"]]], [], []]
    assert ask(api, bob, "getTopicTypes", "/bob")[2] == [["/secret", T]]
    assert ask(api, bob, "lookupNode", "/bob", "/victim")[2] == VICTIM_API


def test_m1_parameter_rights_show_no_topics(api: MasterApi) -> None:
    bob = caller("/bob", {"/secret": Right.PARAM_GET | Right.PARAM_SET | Right.ADMIN})
    assert ask(api, bob, "getSystemState", "/bob")[2] == [[], [], []]


def test_own_entries_are_always_shown_and_only_they(api: MasterApi) -> None:
    who = caller("/bob", {"/cmd_vel": Right.SUBSCRIBE})
    ask(api, who, "registerSubscriber", "/bob", "/cmd_vel", T, "http://bob:1/")
    later = caller("/bob")  # the grant has expired
    assert ask(api, later, "getSystemState", "/bob")[2] == [[], [["/cmd_vel", ["/bob"]]], []]
    assert ask(api, later, "getTopicTypes", "/bob")[2] == [["/cmd_vel", T]]
    assert ask(api, later, "lookupNode", "/bob", "/bob")[2] == "http://bob:1/"


@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("registerPublisher", ("/cmd_vel", T, EVIL_API)),
        ("registerSubscriber", ("/cmd_vel", T, EVIL_API)),
        ("registerService", ("/arm", "rosrpc://evil:2", EVIL_API)),
        ("unregisterPublisher", ("/secret", VICTIM_API)),
        ("unregisterSubscriber", ("/cmd_vel", VICTIM_API)),
        ("unregisterService", ("/arm", "rosrpc://victim:2")),
        ("getParam", ("/x",)),
        ("shutdown", ("",)),
        ("rossec.presentGrants", ([],)),
    ],
)
def test_m2_m3_m4_a_caller_cannot_act_under_another_name(
    api: MasterApi, method: str, params: tuple[object, ...]
) -> None:
    before = ask(api, everything("/victim"), "getSystemState", "/victim")
    outcome = call_api(api, method, ("/victim", *params), caller("/eve", BUT_ADMIN), 0)
    assert [type(event) for event in outcome.events] == [CallDenied]
    assert isinstance(outcome.answer, list)
    assert outcome.answer[0] == -1
    assert "belongs to /eve" in outcome.answer[1]
    assert ask(api, everything("/victim"), "getSystemState", "/victim") == before


@pytest.mark.parametrize("caller_id", ["", "eve", "/eve/", "//eve", "/EVE", "/eve2"])
def test_the_name_is_compared_exactly(api: MasterApi, caller_id: str) -> None:
    assert ask(api, everything("/eve"), "getUri", caller_id)[0] == -1


def test_m4_unregistering_under_ones_own_name_touches_nothing(api: MasterApi) -> None:
    for method, *params in (
        ("unregisterPublisher", "/secret", VICTIM_API),
        ("unregisterService", "/arm", "rosrpc://victim:2"),
    ):
        assert ask(api, everything("/eve"), method, "/eve", *params)[2] == 0


def test_m5_only_an_administrator_stops_the_master(api: MasterApi) -> None:
    rights = {"/master": Right(255) & ~Right.ADMIN, "/other": Right.ADMIN}
    assert ask(api, caller("/eve", rights), "shutdown", "/eve", "")[0] == -1
    outcome = call_api(
        api, "shutdown", ("/admin", "bye"), caller("/admin", {"/master": Right.ADMIN}), 0
    )
    assert outcome.answer == [1, "shutdown", 0]
    assert [event.reason for event in outcome.events] == ["/admin: bye"]  # type: ignore[union-attr]


@pytest.mark.parametrize("uri", [VICTIM_API, "http://victim:1", "http://VICTIM:1/x"])
def test_m8_anothers_slave_api_cannot_be_registered(api: MasterApi, uri: str) -> None:
    for method, *params in (
        ("registerPublisher", "/t", T, uri),
        ("registerSubscriber", "/t", T, uri),
        ("registerService", "/t", "rosrpc://e:1", uri),
        ("subscribeParam", uri, "/t"),
    ):
        answer = ask(api, everything("/eve"), method, "/eve", *params)
        assert answer[0] == -1
        assert "registered by another node" in answer[1]


def test_m6_a_parent_does_not_circumvent_a_missing_right(api: MasterApi) -> None:
    admin = everything("/admin")
    ask(api, admin, "setParam", "/admin", "/safety/max", 1)
    ask(api, admin, "setParam", "/admin", "/ns/k", 1)
    eve = caller("/eve", {"/ns/**": Right(255), "/ns": Right(255)})
    for method, *params in (
        ("setParam", "/", {"safety": {"max": 9}}),
        ("setParam", "/safety", {"max": 9}),
        ("setParam", "/safety/max/deeper", 9),
        ("deleteParam", "/safety"),
        ("getParam", "/"),
        ("getParam", "/safety"),
        ("getParam", "../safety/max"),
        ("hasParam", "/safety/max"),
        ("subscribeParam", "http://eve:1/", "/"),
    ):
        assert ask(api, eve, method, "/eve", *params)[0] == -1, (method, params)
    assert ask(api, eve, "searchParam", "/eve", "safety/max")[0] == -1
    assert ask(api, eve, "getParamNames", "/eve")[2] == ["/ns/k"]
    assert ask(api, eve, "getParam", "/eve", "/ns")[2] == {"k": 1}
    assert ask(api, admin, "getParam", "/admin", "/safety/max")[2] == 1


def test_require_raises_refused() -> None:
    require(caller("/a", {"/t": Right.CALL}), Right.CALL, "/t")
    with pytest.raises(Refused, match="needs the right call on /u"):
        require(caller("/a", {"/t": Right.CALL}), Right.CALL, "/u")


@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("getParam", ("KEY",)),
        ("hasParam", ("KEY",)),
        ("deleteParam", ("KEY",)),
        ("setParam", ("KEY", 1)),
        ("setParam", ("KEY", {"wifi": {"psk": 1}})),
        ("setParam", ("KEY/wifi/psk/deeper", 1)),
        ("subscribeParam", ("http://eve:1/", "KEY")),
    ],
)
@pytest.mark.parametrize("held", [None, "KEY/wifi/ssid", "KEY/other", "/near/**"])
def test_m6_a_refusal_does_not_reveal_what_is_below(
    api: MasterApi, method: str, params: tuple[object, ...], held: str | None
) -> None:
    ask(api, everything("/admin"), "setParam", "/admin", "/robot/wifi", {"ssid": 1, "psk": 2})
    answers = []
    for key in ("/robot", "/absent"):
        eve = caller("/eve", {held.replace("KEY", key): Right(255)} if held else {})
        filled = (p.replace("KEY", key) if isinstance(p, str) else p for p in params)
        code, status, _ = ask(api, eve, method, "/eve", *filled)
        assert code == -1
        answers.append(status.replace(key, "KEY"))
    assert answers[0] == answers[1]
    asked = next(p for p in reversed(params) if isinstance(p, str) and p.startswith("KEY"))
    assert f" on {asked}: no grant covers it and all below it (ask the auth" in answers[0]


RVIZ = anonymous("/rviz")
ONE, TWO = ("/rviz_1", "http://h:1/"), ("/rviz_2", "http://h:2/")


def test_nodes_of_one_wildcard_have_entries_of_their_own(api: MasterApi) -> None:
    for name, uri in (ONE, TWO):
        assert ask(api, RVIZ, "registerPublisher", name, "/t", T, uri)[0] == 1
    assert ask(api, RVIZ, "getSystemState", "/rviz_1")[2][0][1] == ["/t", ["/rviz_1", "/rviz_2"]]
    assert ask(api, RVIZ, "lookupNode", "/rviz_1", "/rviz_2")[2] == TWO[1]
    assert ask(api, RVIZ, "unregisterPublisher", "/rviz_1", "/t", TWO[1])[2] == 0
    assert ask(api, RVIZ, "unregisterPublisher", "/rviz_1", "/t", ONE[1])[2] == 1
    assert ask(api, RVIZ, "getSystemState", "/rviz_2")[2][0][1] == ["/t", ["/rviz_2"]]


def test_a_node_of_a_wildcard_owns_its_own_address_alone(api: MasterApi) -> None:
    assert ask(api, RVIZ, "registerPublisher", "/rviz_1", "/t", T, ONE[1])[0] == 1
    for uri in (ONE[1], VICTIM_API):
        answer = ask(api, RVIZ, "registerPublisher", "/rviz_2", "/t", T, uri)
        assert answer == [-1, "rossec: this slave API URI is registered by another node", []]


def test_a_node_of_a_wildcard_sees_what_it_registered_itself(api: MasterApi) -> None:
    modest = anonymous("/rviz", {"/t": Right.PUBLISH})
    call_api(api, "registerPublisher", ("/rviz_1", "/t", T, ONE[1]), modest, 0)
    blind = anonymous("/rviz", {"/nothing": Right.PUBLISH})
    assert ask(api, blind, "getSystemState", "/rviz_1")[2] == [[["/t", ["/rviz_1"]]], [], []]
    assert ask(api, blind, "getSystemState", "/rviz_2")[2] == [[], [], []]


@pytest.mark.parametrize(
    "name",
    ["/victim", "/master", "/ca", "/rviz_", "/rvizx", "/rviz_1/a", "/robot/rviz_1", "rviz_1"],
)
def test_a_wildcard_covers_only_its_tail(api: MasterApi, name: str) -> None:
    for method, *params in (
        ("registerPublisher", "/t", T, EVIL_API),
        ("unregisterPublisher", "/secret", VICTIM_API),
        ("setParam", "/p", 1),
        ("getSystemState",),
    ):
        code, status, _ = ask(api, anonymous("/rviz", BUT_ADMIN), method, name, *params)
        assert code == -1
        assert status == "rossec: this connection belongs to /rviz, it cannot act as another"


def test_an_identity_without_a_wildcard_has_one_name(api: MasterApi) -> None:
    code, status, _ = ask(api, everything("/rviz"), "getPid", "/rviz_1")
    assert (code, status.startswith("rossec: this connection belongs to /rviz,")) == (-1, True)


def test_a_denial_names_the_certified_name(api: MasterApi) -> None:
    blind = anonymous("/rviz", {"/nothing": Right.PUBLISH})
    outcome = call_api(api, "registerSubscriber", ("/rviz_1", "/t", T, ONE[1]), blind, 0)
    assert "/rviz_1 (certified as /rviz) needs the right subscribe on /t" in str(outcome.answer)
    assert [event.node for event in outcome.events if isinstance(event, Denied)] == ["/rviz"]
    refused = ask(api, blind, "getParam", "/rviz", "/p")[1]
    assert refused.startswith("rossec: /rviz needs the right param-get on /p")


def test_a_name_is_registered_by_one_key() -> None:
    acting_caller = RVIZ.acting_as("/rviz_1")
    assert acting_caller.acting_as("/rviz_1") is acting_caller
    with pytest.raises(Refused):
        acting_caller.acting_as("/rviz_1_2")
    with pytest.raises(Refused):
        acting_caller.acting_as("/rviz")


def test_an_administrator_cleans_up_after_a_node_and_does_nothing_else_for_it(
    api: MasterApi,
) -> None:
    """`rosnode cleanup`."""
    operator = caller("/operator", {"/victim": Right.ADMIN, "/secret": ALL})
    assert ask(api, operator, "registerPublisher", "/victim", "/secret", T, EVIL_API)[0] == -1
    assert ask(api, operator, "unregisterPublisher", "/other", "/secret", VICTIM_API)[0] == -1
    assert ask(api, operator, "unregisterPublisher", "/victim", "/secret", EVIL_API)[2] == 0
    assert ask(api, operator, "unregisterPublisher", "/victim", "/secret", VICTIM_API)[2] == 1


@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("registerPublisher", ("/t", "*", "URI")),
        ("registerSubscriber", ("/t", "*", "URI")),
        ("registerService", ("/s", "rosrpc://h:1", "URI")),
        ("subscribeParam", ("URI", "/p")),
    ],
)
def test_m8_a_node_on_another_host_cannot_register_loopback(
    api: MasterApi, method: str, params: tuple[str, ...]
) -> None:
    who = everything("/a")
    here, there = (
        ["/a", *[value.replace("URI", uri) for value in params]]
        for uri in ("http://localhost:9/", "http://10.0.0.7:9/")
    )

    def answer(method: str, params: list[Any], *, is_local: bool) -> Any:
        return call_api(api, method, params, who, 0, is_local=is_local).answer

    code, status, _ = refused = answer(method, here, is_local=False)
    assert (code, "on the master's host, and the caller is not" in status) == (-1, True)
    element = {"methodName": method, "params": here}
    assert answer("system.multicall", [[element]], is_local=False) == [[refused]]
    assert answer(method, there, is_local=False)[0] == 1
    assert answer(method, here, is_local=True)[0] == 1


def test_the_nodes_of_a_key_are_limited() -> None:
    api = MasterApi(Registry(1), FakeStatements(), name="/master", uri="u", pid=1)

    def answer(name: str, uri: str) -> Any:
        return call_api(
            api, "registerPublisher", [name, "/t", "*", uri], anonymous("/rviz"), 0
        ).answer

    assert answer("/rviz_1", "http://h:1/")[0] == 1
    for name in ("/rviz_2", "/rviz"):
        text = f"rossec: the identity of {name} has 1 nodes, the limit of one key"
        assert answer(name, "http://h:2/") == [-1, text, []]
    assert answer("/rviz_1", "http://h:3/")[0] == 1
