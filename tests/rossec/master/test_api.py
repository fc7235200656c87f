"""The dispatch: multicall, rossec's own methods, what stock has no test for."""

from typing import Any

import pytest

from grants.model import Right
from rossec.master.api import MULTICALL_ANSWER, MULTICALL_LIMIT, Fault, MasterApi
from rossec.master.calls import CallRefused, Denied
from rossec.master.gatekeeper import Caller
from rossec.master.registry import KEYS_LIMIT, Registry
from tests.rossec.master.fakes import FakeStatements, caller, everything


@pytest.fixture
def statements() -> FakeStatements:
    return FakeStatements()


@pytest.fixture
def api(statements: FakeStatements) -> MasterApi:
    return MasterApi(Registry(), statements, name="/master", uri="http://m:1/", pid=7)


def ask(api: MasterApi, who: Caller, method: str, *params: object) -> Any:
    return api.call(method, params, who, 0).answer


def element(method: str, *params: object) -> dict[str, object]:
    return {"methodName": method, "params": list(params)}


def test_who_the_master_is(api: MasterApi) -> None:
    assert ask(api, caller("/a"), "getUri", "/a") == [1, "", "http://m:1/"]
    assert ask(api, caller("/a"), "getPid", "/a") == [1, "", 7]


def test_each_element_of_a_multicall_is_authorized_alone(api: MasterApi) -> None:
    who = caller("/a", {})
    answers = ask(
        api, who, "system.multicall",
        [element("getUri", "/a"), element("setParam", "/a", "/x", 1), element("getUri", "/victim")],
    )  # fmt: skip
    assert [answer[0][0] for answer in answers] == [1, -1, -1]


def test_the_answers_of_a_multicall_are_bounded(api: MasterApi) -> None:
    """Else 4096 short questions have the master write four gigabytes."""
    who = everything("/a")
    ask(api, who, "setParam", "/a", "/big", "x" * (MULTICALL_ANSWER // 2))
    calls = [element("getParam", "/a", "/big")] * 100 + [element("setParam", "/a", "/last", 1)]
    calls.insert(0, element("setParam", "/a", "/first", 1))
    outcome = api.call("system.multicall", [calls], who, 0)
    assert isinstance(outcome.answer, Fault)
    assert "too long: 3 of its 102 calls were made" in outcome.answer.faultString
    assert len(outcome.events) == 1  # of what was done
    assert ask(api, who, "hasParam", "/a", "/first")[2] is True
    assert ask(api, who, "hasParam", "/a", "/last")[2] is False


def test_all_parameters_together_are_bounded() -> None:
    api = MasterApi(
        Registry(), FakeStatements(), name="/master", uri="u", pid=1, parameter_bytes=10_000
    )
    assert ask(api, everything("/a"), "setParam", "/a", "/x", "x" * 9000)[0] == 1
    code, status, _ = ask(api, everything("/a"), "setParam", "/a", "/y", "x" * 9000)
    assert (code, "more than 10000 bytes" in status) == (-1, True)


def test_multicall_events_are_all_delivered(api: MasterApi) -> None:
    who = everything("/a")
    calls = [element("registerPublisher", "/a", f"/t{n}", "*", "http://a:1/") for n in range(3)]
    assert len(api.call("system.multicall", [calls], who, 0).events) == 3


@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("rossec.presentGrants", ([b"one"],)),
        ("rossec.revocations", ()),
        ("rossec.updateRevocations", (b"list",)),
    ],
)
def test_what_is_costly_comes_once_in_a_multicall(
    api: MasterApi, method: str, params: tuple[object, ...]
) -> None:
    again = element(method, "/a", *params)
    calls = [again, element("getPid", "/a"), again, again]
    first, other, *rest = ask(api, caller("/a"), "system.multicall", calls)
    assert (first[0][0], other) == (1, [[1, "", 7]])
    assert [answer["faultString"] for answer in rest] == [
        f"rossec: more than one {method} in a multicall"
    ] * 2


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
    for n in range(KEYS_LIMIT):
        filled = [text.format(n) for text in params]
        assert ask(api, everything("/a"), method, "/a", *filled)[0] == 1
    refused = ask(api, everything("/a"), method, "/a", *[text.format("x") for text in params])
    assert refused[0] == -1
    assert refused[1] == f"rossec: /a has 1024 registrations as {kind}, the most of a node"


def test_a_multicall_in_a_multicall_is_refused(api: MasterApi) -> None:
    inner = element("system.multicall", [element("getPid", "/a")])
    [answer] = ask(api, caller("/a"), "system.multicall", [inner])
    assert "inside a multicall" in answer["faultString"]


@pytest.mark.parametrize(
    "broken", [5, {}, {"methodName": 1, "params": []}, {"methodName": "getPid"}, ["getPid"]]
)
def test_a_broken_element_spoils_only_itself(api: MasterApi, broken: object) -> None:
    bad, good = ask(api, caller("/a"), "system.multicall", [broken, element("getPid", "/a")])
    assert "needs methodName and params" in bad["faultString"]
    assert good == [[1, "", 7]]


@pytest.mark.parametrize(
    "params",
    [
        [],
        [[], []],
        ["text"],
        [[element("getPid", "/a")] * (MULTICALL_LIMIT + 1)],
        [[element("getSystemState", "/a")] * 17],
    ],
)
def test_a_multicall_is_bounded(api: MasterApi, params: list[object]) -> None:
    with pytest.raises(Fault, match="multicall"):
        api.call("system.multicall", params, caller("/a"), 0)


def test_refusals_are_told_one_by_one_also_within_a_multicall(api: MasterApi) -> None:
    who = caller("/a", {})
    calls = [
        element("setParam", "/a", "/x", 1), element("getUri", "/victim"), element("getUri", "/a"),
    ]  # fmt: skip
    events = api.call("system.multicall", [calls], who, 0).events
    refused = [event for event in events if isinstance(event, CallRefused)]
    assert [(event.node, event.method) for event in refused] == [
        ("/a", "setParam"), ("/a", "getUri"),
    ]  # fmt: skip
    assert all(event.status.startswith("rossec: ") for event in refused)
    assert Denied("/a", Right.PARAM_SET, "/x") in events
