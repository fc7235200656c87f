"""Multicalls: each element is authorized alone; all are limited and processed in turns."""

from collections.abc import Callable
from itertools import count
from typing import Any

import pytest

from grants.model import Right
from rossec.master.api.dispatch import (
    MULTICALL_ANSWER,
    MULTICALL_LIMIT,
    MULTICALL_ONCE,
    Fault,
    MasterApi,
    Multicall,
)
from rossec.master.api.graph_calls import WATCH
from rossec.master.api.methods import CallDenied, Denied
from rossec.master.rights.caller import NAMES_PER_YIELD, Caller
from rossec.master.state.registry import Registry
from rossec.ros.xmlrpc import dump_call, dump_response
from tests.rossec.master.fakes import FakeStatements, call_api, caller, everything, master_api, step


@pytest.fixture
def api() -> MasterApi:
    return master_api(Registry(), FakeStatements(), name="/master", uri="http://m:1/", pid=7)


def ask(api: MasterApi, who: Caller, method: str, *params: object) -> Any:
    return call_api(api, method, params, who, 0).answer


def element(method: str, *params: object) -> dict[str, object]:
    return {"methodName": method, "params": list(params)}


def test_each_element_of_a_multicall_is_authorized_alone(api: MasterApi) -> None:
    who = caller("/a", {})
    answers = ask(
        api,
        who,
        "system.multicall",
        [element("getUri", "/a"), element("setParam", "/a", "/x", 1), element("getUri", "/victim")],
    )
    assert [answer[0][0] for answer in answers] == [1, -1, -1]


def test_the_answers_of_a_multicall_are_bounded(api: MasterApi) -> None:
    """Else 4096 short requests make the master send four gigabytes."""
    who = everything("/a")
    ask(api, who, "setParam", "/a", "/big", "x" * (MULTICALL_ANSWER // 2))
    calls = [element("getParam", "/a", "/big")] * 100 + [element("setParam", "/a", "/last", 1)]
    calls.insert(0, element("setParam", "/a", "/first", 1))
    outcome = call_api(api, "system.multicall", [calls], who, 0)
    assert isinstance(outcome.answer, Fault)
    assert "too long: 3 of its 102 calls were made" in outcome.answer.faultString
    assert len(outcome.events) == 1  # of the calls made
    assert ask(api, who, "hasParam", "/a", "/first")[2] is True
    assert ask(api, who, "hasParam", "/a", "/last")[2] is False


def test_multicall_events_are_all_delivered(api: MasterApi) -> None:
    who = everything("/a")
    calls = [element("registerPublisher", "/a", f"/t{n}", "*", "http://a:1/") for n in range(3)]
    assert len(call_api(api, "system.multicall", [calls], who, 0).events) == 3


@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("rossec.presentGrants", ([b"one"],)),
        ("rossec.revocations", ()),
        ("rossec.updateRevocations", (b"list",)),
    ],
)
def test_expensive_methods_are_allowed_once_in_a_multicall(
    api: MasterApi, method: str, params: tuple[object, ...]
) -> None:
    again = element(method, "/a", *params)
    calls = [again, element("getPid", "/a"), again, again]
    first, other, *rest = ask(api, caller("/a"), "system.multicall", calls)
    assert (first[0][0], other) == (1, [[1, "", 7]])
    assert [answer["faultString"] for answer in rest] == [
        f"rossec: more than one {method} in a multicall"
    ] * 2


def test_a_multicall_in_a_multicall_is_refused(api: MasterApi) -> None:
    inner = element("system.multicall", [element("getPid", "/a")])
    [answer] = ask(api, caller("/a"), "system.multicall", [inner])
    assert "inside a multicall" in answer["faultString"]


@pytest.mark.parametrize(
    "broken", [5, {}, {"methodName": 1, "params": []}, {"methodName": "getPid"}, ["getPid"]]
)
def test_a_malformed_element_affects_no_other(api: MasterApi, broken: object) -> None:
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
        call_api(api, "system.multicall", params, caller("/a"), 0)


def test_each_refused_element_is_a_denial(api: MasterApi) -> None:
    who = caller("/a", {})
    calls = [element("setParam", "/a", "/x", 1), element("getUri", "/victim"), element("getUri", "/a")]
    events = call_api(api, "system.multicall", [calls], who, 0).events
    refused = [event for event in events if isinstance(event, CallDenied)]
    assert [(event.node, event.method) for event in refused] == [("/a", "setParam"), ("/a", "getUri")]
    assert all(event.status.startswith("rossec: ") for event in refused)
    assert Denied("/a", Right.PARAM_SET, "/x") in events


def test_each_turn_uses_the_rights_of_that_time(api: MasterApi) -> None:
    calls = [element("setParam", "/a", f"/p{number}", 1) for number in range(7)]
    multicall, outcome = Multicall([calls]), []
    # Its grant was revoked during the query.
    for who, done in ((everything, False), (caller, False), (everything, True), (everything, True)):
        outcome.append(len(step(api, multicall, who("/a"), expired=after(3))))
        assert multicall.done == done
    answers: Any = multicall.answer
    assert [answer[0][0] for answer in answers] == [1] * 3 + [-1] * 3 + [1]
    assert outcome == [3, 6, 1, 0]  # a refusal is two events


def test_a_query_in_a_multicall_takes_as_many_turns_as_it_needs(api: MasterApi) -> None:
    for number in range(5 * NAMES_PER_YIELD):
        ask(api, everything("/a"), "registerPublisher", "/a", f"/t{number}", "*", "http://a:1/")
    calls = [element("getPid", "/a"), element("getTopicTypes", "/a"), element("getPid", "/a")]
    multicall, turns = Multicall([calls]), 0
    while not multicall.done:
        step(api, multicall, everything("/a"), expired=lambda: True)
        turns += 1
    answers: Any = multicall.answer
    assert [len(answers), len(answers[1][0][2])] == [3, 5 * NAMES_PER_YIELD]
    assert turns == 1 + 6 + 1


def test_a_query_restarts_when_rights_change(api: MasterApi) -> None:
    """Also for a method that is allowed once, and here is started twice."""
    for number in range(2 * NAMES_PER_YIELD):
        ask(api, everything("/a"), "registerPublisher", "/a", f"/t{number}", "*", "http://a:1/")
    multicall = Multicall([[element(WATCH, "/b", "", 0), element("getPublishedTopics", "/b", "")]])
    step(api, multicall, everything("/b"), expired=lambda: True)
    multicall.restart_element()
    step(api, multicall, caller("/b", {"/master": Right.GRAPH}))
    answers: Any = multicall.answer
    assert answers[0][0][:1] == [1]
    assert answers[0][0][2]["added"] == []
    assert answers[1][0][2] == []


def after(times: int) -> Callable[[], bool]:
    """A turn that expires at the given number of checks."""
    checks = count(1)
    return lambda: next(checks) >= times


@pytest.mark.parametrize(
    "changes", [element("rossec.updateRevocations", "/a", b"list"), element("rossec.presentGrants", "/a", [])]
)
def test_an_element_that_changes_rights_ends_the_step(api: MasterApi, changes: Any) -> None:
    multicall = Multicall([[element("getPid", "/a"), changes, element("getPid", "/a")]])
    step(api, multicall, caller("/a"))
    outcome: Any = multicall.answer
    assert (len(outcome), multicall.done) == (2, False)
    step(api, multicall, caller("/a"))
    assert multicall.done


def test_an_empty_multicall_is_done(api: MasterApi) -> None:
    assert Multicall([[]]).done
    assert ask(api, caller("/a"), "system.multicall", []) == []


def test_expensive_methods_exist(api: MasterApi) -> None:
    assert set(api.methods) >= MULTICALL_ONCE > {WATCH}


def test_a_multicall_at_the_limit_is_answered(api: MasterApi) -> None:
    """A value that fits into a call of setParam fits into its answer."""
    calls = [
        element("setParam", "/a", f"/a/robot/with/a/name/parameter{number}", 1)
        for number in range(MULTICALL_LIMIT - 500)
    ]
    answers = ask(api, everything("/a"), "system.multicall", calls)
    assert len(answers) == len(calls)
    assert len(dump_response(answers)) < MULTICALL_ANSWER
    assert len(dump_call("system.multicall", [calls])) > MULTICALL_ANSWER
