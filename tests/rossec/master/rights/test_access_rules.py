"""The policy table: default deny, and the attacks on the Master API that need only the cores."""

from dataclasses import replace

import pytest

from grants.model import Right
from rossec.master.api.dispatch import MasterApi
from rossec.master.api.methods import CallDenied
from rossec.master.rights.access_rules import RULES, AccessControl, Scope, is_authority, require
from rossec.master.rights.caller import Refused
from rossec.master.state.graph import Graph
from rossec.master.state.imports import Imports
from rossec.master.state.registry import Registry
from tests.rossec.master.fakes import call_api, caller, everything
from tests.rossec.master.rights.victim import BUT_ADMIN, EVIL_API, VICTIM_API, T, ask
from tests.support.authority import Site


def test_every_method_has_a_rule_and_every_rule_a_method(api: MasterApi) -> None:
    assert set(api.methods) == set(RULES)


def test_every_rule_that_names_or_reaches_something_has_a_right() -> None:
    for rule in RULES.values():
        assert (rule.right is not None) == (rule.scope in (Scope.NAMED, Scope.TREE, Scope.MASTER))


def empty_graph() -> Graph:
    registry = Registry()
    return Graph(registry, Imports(registry))


def test_a_method_without_a_rule_is_refused() -> None:
    with pytest.raises(Refused, match="no rule"):
        AccessControl(empty_graph(), "/master").check("newMethod", everything("/a"), ("/a",))


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
    assert "rossec grant sign /x --" in status


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
    outcome = call_api(api, "shutdown", ("/admin", "bye"), caller("/admin", {"/master": Right.ADMIN}), 0)
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
    said = f" on {asked}: no grant covers it and all below it (rossec grant sign /eve --param-"
    assert said in answers[0]


def test_the_authority_is_its_name_certified_by_the_root() -> None:
    site = Site()
    own = site.enroll("/ca").identity
    assert is_authority(own)
    assert not is_authority(replace(own, issuers=(b"i" * 32,))), "below an intermediate"
    assert not is_authority(replace(own, wildcard=True))
    for name in ("/cab", "/ca/x", "/master"):
        assert not is_authority(replace(own, name=name))


def test_what_only_the_authority_may_call_needs_no_right_and_is_given_by_none() -> None:
    control = AccessControl(empty_graph(), "/master")
    for method in (name for name, rule in RULES.items() if rule.scope is Scope.AUTHORITY):
        for who in (everything("/ca"), everything("/master"), everything("/a")):
            with pytest.raises(Refused, match="only the authority's own node"):
                control.check(method, who, (who.name, []))
        own = replace(caller("/ca"), is_authority=True)
        control.check(method, own, ("/ca", []))


def test_the_authority_sees_the_graph_without_a_grant_and_changes_nothing() -> None:
    own = replace(caller("/ca"), is_authority=True)
    for who, sees in ((own, True), (caller("/ca"), False)):
        assert who.may(Right.GRAPH, "/master") is sees
        assert who.may_see("/anything") is sees
    for right in set(Right) - {Right.GRAPH}:
        assert not own.may(right, "/anything"), right


FOREIGNER = "/remote/hospital/rounds/robot3"


@pytest.mark.parametrize(
    ("host", "is_local", "taken"),
    [
        ("10.0.0.9", False, True),
        ("robot.example", False, True),
        ("169.254.3.1", False, False),
        ("169.254.3.1", True, False),
        ("[fe80::1]", True, False),
        ("127.0.0.1", False, False),
        ("127.0.0.1", True, True),
        ("localhost", True, True),
    ],
)
def test_addresses_that_a_foreigner_may_have(api: MasterApi, host: str, is_local: bool, taken: bool) -> None:
    who, uri = caller(FOREIGNER, {"/**": Right(255)}), f"http://{host}:7/"
    for method, *params in (
        ("registerPublisher", "/t", T, uri),
        ("registerService", "/s", f"rosrpc://{host}:7", "http://10.0.0.9:8/"),
        ("subscribeParam", uri, "/rate"),
    ):
        call = "/rounds/robot3", *params
        answer = call_api(api, method, call, who, 0, is_local=is_local).answer
        assert isinstance(answer, list)
        assert (answer[0] == 1) == taken, answer


@pytest.mark.parametrize("uri", ["rosrpc://victim:2", "rosrpc://VICTIM:2", "rosrpc://victim:1"])
def test_m8_a_foreigners_service_is_not_at_the_address_of_another(api: MasterApi, uri: str) -> None:
    """Neither at its service (port 2) nor at its slave API (port 1)."""
    who, own = caller(FOREIGNER, {"/**": Right(255)}), "http://10.0.0.9:8/"
    answer = ask(api, who, "registerService", "/rounds/robot3", "/s", uri, own)
    assert (answer[0], "registered by another node" in answer[1]) == (-1, True)
    api_there = uri.replace("rosrpc", "http")
    assert ask(api, who, "registerPublisher", "/rounds/robot3", "/t", T, api_there)[0] == -1


def test_the_services_of_a_foreigner_may_share_an_address(api: MasterApi) -> None:
    who = caller(FOREIGNER, {"/**": Right(255)})
    for service in ("/s", "/s", "/u"):
        call = "/rounds/robot3", service, "rosrpc://10.0.0.9:7", "http://10.0.0.9:8/"
        assert ask(api, who, "registerService", *call)[0] == 1


def test_an_administrator_cleans_up_what_a_foreigner_registered(api: MasterApi) -> None:
    uri = "http://10.0.0.9:7/"
    ask(api, caller(FOREIGNER, {"/t": Right.PUBLISH}), "registerPublisher", "/rounds/robot3", "/t", T, uri)
    admin = caller("/admin", {"/**": Right.ADMIN})
    assert ask(api, caller("/eve"), "unregisterPublisher", FOREIGNER, "/t", uri)[0] == -1
    assert ask(api, admin, "unregisterPublisher", FOREIGNER, "/t", uri)[2] == 1


def test_a_foreigner_cleans_up_nothing_of_ours(api: MasterApi) -> None:
    twin = caller("/remote/hospital/victim", BUT_ADMIN)
    ask(api, twin, "unregisterPublisher", "/victim", "/secret", VICTIM_API)
    ask(api, twin, "unregisterService", "/victim", "/arm", "rosrpc://victim:2")
    state = ask(api, everything("/victim"), "getSystemState", "/victim")[2]
    assert state == [[["/secret", ["/victim"]]], [["/cmd_vel", ["/victim"]]], [["/arm", ["/victim"]]]]


def test_a_foreigners_service_is_its_own(api: MasterApi) -> None:
    twin = caller("/remote/hospital/victim", BUT_ADMIN)
    uri = "rosrpc://10.0.0.9:2"
    ask(api, twin, "registerService", "/victim", "/s", uri, "http://10.0.0.9:1/")
    assert ask(api, twin, "unregisterService", "/victim", "/s", uri)[2] == 1


@pytest.mark.parametrize("method", sorted(n for n, r in RULES.items() if r.scope is Scope.MEMBER))
def test_what_members_may_call_no_foreigner_may(api: MasterApi, method: str) -> None:
    control = AccessControl(empty_graph(), "/master")
    control.check(method, caller("/robot"), ("/robot",))
    with pytest.raises(Refused, match="only nodes of the own domain"):
        control.check(method, caller(FOREIGNER), ("/rounds/robot3",))
