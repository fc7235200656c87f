"""The dispatch: rossec's own methods and limits, which stock does not have."""

from typing import Any
from xmlrpc.client import Fault

import pytest

from grants.model import Right
from rossec.master.api.dispatch import MasterApi
from rossec.master.api.methods import CallDenied, Denied, StopMaster
from rossec.master.rights.caller import Caller
from rossec.master.state.registry import REGISTRATIONS_LIMIT, Registry
from rossec.ros.xmlrpc import is_unknown_method
from tests.rossec.master.fakes import FakeStatements, call_api, caller, everything, master_api


@pytest.fixture
def statements() -> FakeStatements:
    return FakeStatements()


@pytest.fixture
def api(statements: FakeStatements) -> MasterApi:
    return master_api(Registry(), statements, name="/master", uri="http://m:1/", pid=7)


def ask(api: MasterApi, who: Caller, method: str, *params: object) -> Any:
    return call_api(api, method, params, who, 0).answer


def element(method: str, *params: object) -> dict[str, object]:
    return {"methodName": method, "params": list(params)}


def test_uri_and_pid_of_the_master(api: MasterApi) -> None:
    assert ask(api, caller("/a"), "getUri", "/a") == [1, "", "http://m:1/"]
    assert ask(api, caller("/a"), "getPid", "/a") == [1, "", 7]


def test_all_parameters_together_are_bounded() -> None:
    api = master_api(Registry(), FakeStatements(), name="/master", uri="u", pid=1, parameter_bytes=10_000)
    for name in ("/a", "/b"):
        assert ask(api, everything(name), "setParam", name, name, "x" * 4500)[0] == 1
    code, status, _ = ask(api, everything("/c"), "setParam", "/c", "/c", "x" * 4500)
    assert (code, "more than 10000 bytes" in status) == (-1, True)


@pytest.mark.parametrize(
    ("method", "params", "kind"),
    [
        ("registerPublisher", ("/n{}", "*", "http://a:1/"), "publisher"),
        ("registerSubscriber", ("/n{}", "*", "http://a:1/"), "subscriber"),
        ("registerService", ("/n{}", "rosrpc://a:2", "http://a:1/"), "service"),
        ("subscribeParam", ("http://a:1/", "/n{}"), "parameter subscriber"),
    ],
)
def test_one_node_cannot_fill_the_registry(
    api: MasterApi, method: str, params: tuple[str, ...], kind: str
) -> None:
    for n in range(REGISTRATIONS_LIMIT):
        filled = [text.format(n) for text in params]
        assert ask(api, everything("/a"), method, "/a", *filled)[0] == 1
    refused = ask(api, everything("/a"), method, "/a", *[text.format("x") for text in params])
    assert refused[0] == -1
    assert refused[1] == f"rossec: /a has 1024 registrations as {kind}, the limit of a node"


@pytest.mark.parametrize(
    ("params", "status"),
    [
        ((), "missing required caller_id parameter"),
        (("/a",), "Error: bad call arity"),
        (("/a", "/t", "more"), "Error: bad call arity"),
        ((5, "/t"), "caller_id must be a string"),
        (("/a", ""), "ERROR: parameter [service] must be a non-empty string"),
    ],
)
def test_a_call_with_other_arguments_gets_the_default(
    api: MasterApi, params: tuple[object, ...], status: str
) -> None:
    assert ask(api, everything("/a"), "lookupService", *params) == [-1, status, ""]


def test_an_unknown_method_is_a_fault(api: MasterApi) -> None:
    with pytest.raises(Fault, match='method "dance" is not supported') as unknown:
        ask(api, everything("/a"), "dance", "/a")
    assert is_unknown_method(unknown.value)


def test_a_refused_call_is_reported_with_the_missing_right(api: MasterApi) -> None:
    params = ("/a", "/t", "*", "http://a:1/")
    outcome = call_api(api, "registerPublisher", params, caller("/a"), 0)
    assert isinstance(outcome.answer, list)
    assert (outcome.answer[0], outcome.answer[2]) == (-1, [])
    reported, denied = outcome.events
    assert denied == Denied("/a", Right.PUBLISH, "/t")
    assert isinstance(reported, CallDenied)
    assert (reported.node, reported.method) == ("/a", "registerPublisher")


def test_nobody_calls_under_another_name(api: MasterApi) -> None:
    code, status, default = ask(api, everything("/a"), "lookupService", "/b", "/s")
    assert (code, default) == (-1, "")
    assert "/a" in status


def test_only_an_administrator_stops_the_master(api: MasterApi) -> None:
    stopped = call_api(api, "shutdown", ("/op", "maintenance"), everything("/op"), 0)
    assert StopMaster("/op: maintenance") in stopped.events
    refused = call_api(api, "shutdown", ("/a", "maintenance"), caller("/a"), 0)
    assert not any(isinstance(event, StopMaster) for event in refused.events)
