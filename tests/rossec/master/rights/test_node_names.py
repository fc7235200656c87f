"""The names of a caller: wildcard identities, cleaning up, addresses of others."""

from typing import Any

import pytest

from grants.model import Right
from rossec.master.api.dispatch import MasterApi
from rossec.master.api.methods import Denied
from rossec.master.rights.caller import Refused
from rossec.master.state.registry import Registry
from tests.rossec.master.fakes import ALL, FakeStatements, anonymous, call_api, caller, everything, master_api
from tests.rossec.master.rights.victim import BUT_ADMIN, EVIL_API, VICTIM_API, T, ask

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
        assert answer == [-1, "rossec: this address is registered by another node", []]


def test_a_node_of_a_wildcard_sees_what_it_registered_itself(api: MasterApi) -> None:
    modest = anonymous("/rviz", {"/t": Right.PUBLISH})
    call_api(api, "registerPublisher", ("/rviz_1", "/t", T, ONE[1]), modest, 0)
    blind = anonymous("/rviz", {"/nothing": Right.PUBLISH})
    assert ask(api, blind, "getSystemState", "/rviz_1")[2] == [[["/t", ["/rviz_1"]]], [], []]
    assert ask(api, blind, "getSystemState", "/rviz_2")[2] == [[], [], []]


@pytest.mark.parametrize(
    "name", ["/victim", "/master", "/ca", "/rviz_", "/rvizx", "/rviz_1/a", "/robot/rviz_1", "rviz_1"]
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


def test_an_administrator_cleans_up_after_a_node_and_does_nothing_else_for_it(api: MasterApi) -> None:
    """`rosnode cleanup`."""
    operator = caller("/operator", {"/victim": Right.ADMIN, "/secret": ALL})
    assert ask(api, operator, "registerPublisher", "/victim", "/secret", T, EVIL_API)[0] == -1
    assert ask(api, operator, "unregisterPublisher", "/other", "/secret", VICTIM_API)[0] == -1
    assert ask(api, operator, "unregisterPublisher", "/victim", "/secret", EVIL_API)[2] == 0
    assert ask(api, operator, "unregisterPublisher", "/victim", "/secret", VICTIM_API)[2] == 1


def test_the_administrator_of_a_provider_may_look_its_service_up(api: MasterApi) -> None:
    """`rosnode cleanup` does, to unregister it by its address."""
    ask(
        api,
        caller("/victim", {"/arm": Right.PROVIDE}),
        "registerService",
        "/victim",
        "/arm",
        "rosrpc://10.0.0.9:2",
        VICTIM_API,
    )
    admin = caller("/tool", {"/victim": Right.ADMIN})
    assert ask(api, admin, "lookupService", "/tool", "/arm")[2] == "rosrpc://10.0.0.9:2"
    assert ask(api, admin, "lookupService", "/tool", "/none")[0] == -1
    other = caller("/tool", {"/victim2": Right.ADMIN, "/arm": Right.ADMIN})
    assert ask(api, other, "lookupService", "/tool", "/arm")[0] == -1


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
    api = master_api(Registry(1), FakeStatements(), name="/master", uri="u", pid=1)

    def answer(name: str, uri: str) -> Any:
        return call_api(api, "registerPublisher", [name, "/t", "*", uri], anonymous("/rviz"), 0).answer

    assert answer("/rviz_1", "http://h:1/")[0] == 1
    for name in ("/rviz_2", "/rviz"):
        text = f"rossec: the identity of {name} has 1 nodes, the limit of one key"
        assert answer(name, "http://h:2/") == [-1, text, []]
    assert answer("/rviz_1", "http://h:3/")[0] == 1
