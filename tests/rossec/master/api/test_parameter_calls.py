"""Parameter calls: updates, rights, limits; answers are compared in test_differential."""

from dataclasses import replace

import pytest

from grants.model import Right
from rossec.master.api import parameter_calls
from rossec.master.api.dispatch import MasterApi
from rossec.master.api.methods import MasterEvent, ParameterChanged, PersistParameter
from rossec.master.rights.caller import NAMES_PER_YIELD, Caller
from rossec.master.state.journals import ParameterChange
from rossec.master.state.registry import NodeRef, Registry
from rossec.ros.xmlrpc import BODY_LIMIT, Fault
from tests.rossec.master.fakes import FakeStatements, call_api, caller, everything, master_api

A, B = NodeRef("/a", "http://a:1/", b"/a"), NodeRef("/b", "http://b:1/", b"/b")


@pytest.fixture
def statements() -> FakeStatements:
    return FakeStatements({"/a": everything("/a"), "/b": everything("/b")})


@pytest.fixture
def api(statements: FakeStatements) -> MasterApi:
    api = master_api(Registry(), statements, name="/master", uri="http://m:1/", pid=1)
    for node in (A, B):
        ask(api, everything(node.name), "subscribeParam", node.uri, "/ns")
    return api


def ask(api: MasterApi, who: Caller, method: str, *params: object) -> tuple[MasterEvent, ...]:
    outcome = call_api(api, method, (who.name, *params), who, 0)
    assert isinstance(outcome.answer, list)
    assert outcome.answer[0] == 1, outcome.answer
    return tuple(event for event in outcome.events if not isinstance(event, PersistParameter))


def test_changes_and_only_changes_are_persisted(api: MasterApi) -> None:
    def events_of(method: str, *params: object) -> list[MasterEvent]:
        outcome = call_api(api, method, ("/a", *params), everything("/a"), 0)
        return [event for event in outcome.events if isinstance(event, PersistParameter)]

    assert events_of("setParam", "k", 1) == [PersistParameter(ParameterChange("/k", 1))]
    assert events_of("deleteParam", "k") == [PersistParameter(ParameterChange("/k", deleted=True))]
    assert events_of("deleteParam", "k") == events_of("setParam", "/", 1) == events_of("getParam", "k") == []


def test_all_subscribers_but_the_setter_are_notified_of_a_change(api: MasterApi) -> None:
    assert ask(api, everything("/a"), "setParam", "/ns/k", 1) == (ParameterChanged(B, "/ns/k/", 1),)
    assert ask(api, everything("/a"), "setParam", "/other", 1) == ()


def test_all_subscribers_are_notified_of_a_deletion(api: MasterApi) -> None:
    ask(api, everything("/a"), "setParam", "/ns/k", 1)
    events = ask(api, everything("/a"), "deleteParam", "/ns/k")
    assert events == (ParameterChanged(A, "/ns/k/", {}), ParameterChanged(B, "/ns/k/", {}))


def test_updates_end_with_the_right(api: MasterApi, statements: FakeStatements) -> None:
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


def test_a_new_slave_api_replaces_the_subscription(api: MasterApi) -> None:
    moved = NodeRef("/b", "http://b:2/", b"/b")
    ask(api, everything("/b"), "subscribeParam", moved.uri, "/ns")
    [event] = ask(api, everything("/a"), "setParam", "/ns/k", 1)
    assert event == ParameterChanged(moved, "/ns/k/", 1)


@pytest.mark.parametrize("rights", [{}, {"/ns/**": Right.PARAM_SET}])
def test_an_illegal_name_in_a_tree_is_named_whatever_the_rights(
    api: MasterApi, rights: dict[str, Right]
) -> None:
    tree = {"fine": 1, "deep": {"not fine": 2}}
    outcome = call_api(api, "setParam", ("/a", "/ns", tree), caller("/a", rights), 0)
    text = "'not fine' cannot be the name of a parameter in a tree"
    assert outcome.answer == [-1, f"Error: invalid arguments: {text}", 0]
    assert outcome.events == ()


@pytest.mark.parametrize("method", ["getParam", "subscribeParam"])
def test_a_value_much_too_long_is_not_encoded(api: MasterApi, method: str) -> None:
    for number in range(3):
        ask(api, everything("/a"), "setParam", f"/long/p{number}", "x" * (BODY_LIMIT - 100))
    params = ("/long",) if method == "getParam" else (A.uri, "/long")
    with pytest.raises(Fault, match=f"an answer of more than {BODY_LIMIT} bytes: ask for less"):
        call_api(api, method, ("/a", *params), everything("/a"), 0)
    assert not any(
        isinstance(event, ParameterChanged) and event.node == A
        for event in ask(api, everything("/b"), "setParam", "/long/p0", 1)
    )


def test_a_list_of_names_too_long_for_an_answer_is_refused_early(
    api: MasterApi, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parameter_calls, "MAX_ENCODED", 5000)
    ask(api, everything("/a"), "setParam", "/many", {f"p{number}": 1 for number in range(99)})
    assert len(call_api(api, "getParamNames", ("/a",), everything("/a"), 0).answer[2]) == 99  # type: ignore[index]
    ask(api, everything("/a"), "setParam", "/more", {f"p{number}": 1 for number in range(99)})
    with pytest.raises(Fault, match="ask for less at a time"):
        call_api(api, "getParamNames", ("/a",), everything("/a"), 0)


def test_a_search_finds_only_readable_parameters(api: MasterApi) -> None:
    tree = {f"p{number}": 1 for number in range(3 * NAMES_PER_YIELD)}
    for key in ("/x", "/ns/x"):
        ask(api, everything("/a"), "setParam", key, tree)

    def search(node: str, key: str, *readable: str) -> object:
        who = caller(node, dict.fromkeys(readable, Right.PARAM_GET))
        answer: list[object] = call_api(api, "searchParam", (node, key), who, 0).answer  # type: ignore[assignment]
        return answer[2]

    last = f"p{3 * NAMES_PER_YIELD - 1}"
    assert search("/ns/n", "x", "/x/p1", f"/ns/x/{last}") == "/ns/x"
    assert search("/ns/n", "x/y", "/x/p1") == "/x/y"
    assert search("/ns/n", "/x", "/ns/x/p1") == search("/ns/n", "x") == ""
    assert search("/ns/n", "/x", "/x/p1") == "/x"


def test_one_key_cannot_use_up_the_limit_of_all_parameters() -> None:
    api = master_api(
        Registry(), FakeStatements(), name="/m", uri="http://m:1/", pid=1, parameter_bytes=10_000
    )

    def put(node: str, key: str, size: int) -> str:
        answer: list[str] = call_api(api, "setParam", (node, key, "x" * size), everything(node), 0).answer  # type: ignore[assignment]
        return answer[1]

    full = "Error: invalid arguments: the parameters that /a has set would take more than 5000 byte"
    assert put("/a", "/a/big", 4000) == "parameter /a/big set"
    assert put("/a", "/a/more", 1000).startswith(full)
    assert put("/b", "/b/big", 4000) == "parameter /b/big set"
    assert "all parameters together would take more than 10000" in put("/b", "/b/big", 6000)
    ask(api, everything("/a"), "deleteParam", "/a/big")
    assert put("/a", "/a/more", 4000) == "parameter /a/more set"
    assert put("/a", "/a/more", 3000) == "parameter /a/more set"
    ask(api, everything("/b"), "deleteParam", "/a")  # another caller frees space
    assert put("/a", "/a/more", 4000).startswith(full), "what it set counts for its key"
    ask(api, everything("/b"), "deleteParam", "/b")
    assert put("/a", "/a/more", 4000) == "parameter /a/more set", "all of it is gone"


def test_a_key_with_many_nodes_is_authorized_once_for_a_change(
    api: MasterApi, statements: FakeStatements, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else one call checks a large tree once for each node of its caller."""
    shared = [NodeRef(f"/rviz_{number}", f"http://c:{number}/", b"rviz") for number in range(1, 21)]
    for node in shared:
        statements.callers[node.name] = replace(everything(node.name), thumbprint=b"rviz")
        ask(api, statements.callers[node.name], "subscribeParam", node.uri, "/ns")
    checked: list[bytes] = []

    def has_right_on_all(who: Caller, *_: object) -> bool:
        checked.append(who.thumbprint)
        return True

    monkeypatch.setattr(parameter_calls, "has_right_on_all", has_right_on_all)
    received = ask(api, everything("/b"), "setParam", "/ns", {"k": 1})
    assert {event.node for event in received if isinstance(event, ParameterChanged)} == {A, *shared}
    assert checked.count(b"rviz") == 1
