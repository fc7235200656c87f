"""Parameter calls: who hears of a change; answers are compared with stock elsewhere."""

import pytest

from grants.model import Right
from rossec.master.api import MasterApi
from rossec.master.calls import MasterEvent, ParameterChanged, ParameterKept
from rossec.master.gatekeeper import Caller
from rossec.master.journal import Change
from rossec.master.registry import NodeRef, Registry
from tests.rossec.master.fakes import FakeStatements, caller, everything

A, B = NodeRef("/a", "http://a:1/", b"/a"), NodeRef("/b", "http://b:1/", b"/b")


@pytest.fixture
def statements() -> FakeStatements:
    return FakeStatements({"/a": everything("/a"), "/b": everything("/b")})


@pytest.fixture
def api(statements: FakeStatements) -> MasterApi:
    api = MasterApi(Registry(), statements, name="/master", uri="http://m:1/", pid=1)
    for node in (A, B):
        ask(api, everything(node.name), "subscribeParam", node.uri, "/ns")
    return api


def ask(api: MasterApi, who: Caller, method: str, *params: object) -> tuple[MasterEvent, ...]:
    outcome = api.call(method, (who.name, *params), who, 0)
    assert isinstance(outcome.answer, list)
    assert outcome.answer[0] == 1, outcome.answer
    return tuple(event for event in outcome.events if not isinstance(event, ParameterKept))


def test_every_change_is_to_be_kept_and_nothing_else(api: MasterApi) -> None:
    def kept(method: str, *params: object) -> list[MasterEvent]:
        outcome = api.call(method, ("/a", *params), everything("/a"), 0)
        return [event for event in outcome.events if isinstance(event, ParameterKept)]

    assert kept("setParam", "k", 1) == [ParameterKept(Change("/k", 1))]
    assert kept("deleteParam", "k") == [ParameterKept(Change("/k", deleted=True))]
    assert kept("deleteParam", "k") == kept("setParam", "/", 1) == kept("getParam", "k") == []


def test_everybody_but_the_setter_hears_of_a_change(api: MasterApi) -> None:
    assert ask(api, everything("/a"), "setParam", "/ns/k", 1) == (ParameterChanged(B, "/ns/k/", 1),)
    assert ask(api, everything("/a"), "setParam", "/other", 1) == ()


def test_everybody_hears_of_a_deletion(api: MasterApi) -> None:
    ask(api, everything("/a"), "setParam", "/ns/k", 1)
    events = ask(api, everything("/a"), "deleteParam", "/ns/k")
    assert events == (ParameterChanged(A, "/ns/k/", {}), ParameterChanged(B, "/ns/k/", {}))


def test_a_lost_right_ends_the_news(api: MasterApi, statements: FakeStatements) -> None:
    statements.callers["/b"] = caller("/b", {"/ns/open": Right.PARAM_GET})
    tree = {"open": 1, "secret": 2}
    assert ask(api, everything("/a"), "setParam", "/ns", tree) == ()
    [event] = ask(api, everything("/a"), "setParam", "/ns/open", 3)
    assert event == ParameterChanged(B, "/ns/open/", 3)
    del statements.callers["/b"]
    assert ask(api, everything("/a"), "setParam", "/ns/open", 4) == ()


def test_unsubscribing(api: MasterApi) -> None:
    ask(api, everything("/b"), "unsubscribeParam", B.uri, "/ns")
    assert ask(api, everything("/a"), "setParam", "/ns/k", 1) == ()


def test_a_new_slave_api_takes_the_subscription_along(api: MasterApi) -> None:
    moved = NodeRef("/b", "http://b:2/", b"/b")
    ask(api, everything("/b"), "subscribeParam", moved.uri, "/ns")
    [event] = ask(api, everything("/a"), "setParam", "/ns/k", 1)
    assert event == ParameterChanged(moved, "/ns/k/", 1)
