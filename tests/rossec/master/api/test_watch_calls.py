"""Watching the graph: the whole state, then changes, and only visible facts."""

from typing import Any

import pytest

from grants.model import Right
from rossec.master.api import graph_calls
from rossec.master.api.dispatch import MasterApi
from rossec.master.api.graph_calls import MAX_VIEWS, WATCH, is_unchanged
from rossec.master.rights.caller import Caller
from rossec.master.state.registry import Registry
from rossec.participant.registrations import GraphView
from tests.rossec.master.fakes import FakeStatements, call_api, caller, everything, master_api

T = "std_msgs/String"
ALL_GRAPH = {"/master": Right.GRAPH, "/**": Right.GRAPH}


def master(instance: str = "first") -> MasterApi:
    return master_api(
        Registry(), FakeStatements(), name="/master", uri="http://m:1/", pid=7, instance=instance
    )


@pytest.fixture
def api() -> MasterApi:
    return master()


class Watcher:
    def __init__(self, api: MasterApi, who: Caller | None = None) -> None:
        self.api = api
        self.who = who or caller("/watcher", ALL_GRAPH)
        self.view = GraphView()
        self.answer: Any = None

    def look(self) -> tuple[list[str], list[str], bool]:
        """The facts added and removed, and whether the answer is the whole state."""
        params = [self.who.name, *self.view.next_params]
        self.asked = params[2]
        self.answer = call_api(self.api, WATCH, params, self.who, 0).answer
        assert self.answer[0] == 1, self.answer
        change = self.view.take(self.answer[2])
        words = [[" ".join(fact) for fact in facts] for facts in change[:2]]
        return words[0], words[1], self.answer[2]["whole"]


def ask(api: MasterApi, who: Caller, method: str, *params: object) -> Any:
    return call_api(api, method, [who.name, *params], who, 0).answer


def do(api: MasterApi, name: str, method: str, *params: object) -> None:
    assert ask(api, everything(name), method, *params)[0] == 1


def test_the_whole_state_is_sent_first_then_changes(api: MasterApi) -> None:
    watcher = Watcher(api)
    assert watcher.look() == ([], [], True)
    do(api, "/laser", "registerPublisher", "/scan", T, "http://l:1/")
    do(api, "/laser", "registerService", "/reset", "rosrpc://l:2", "http://l:1/")
    do(api, "/map", "registerSubscriber", "/scan", "*", "http://n:1/")
    do(api, "/map", "registerSubscriber", "/other", "*", "http://n:1/")
    assert watcher.look() == (
        [
            "node /laser http://l:1/",
            "node /map http://n:1/",
            "provider /reset rosrpc://l:2",
            "publisher /scan /laser",
            "service /reset /laser",
            "subscriber /other /map",
            "subscriber /scan /map",
            f"type /scan {T}",
        ],
        [],
        False,
    )
    assert not is_unchanged(watcher.answer, watcher.asked)
    assert watcher.look() == ([], [], False)
    assert is_unchanged(watcher.answer, watcher.asked)
    do(api, "/laser", "unregisterService", "/reset", "rosrpc://l:2")
    do(api, "/map", "unregisterSubscriber", "/scan", "http://n:1/")
    assert watcher.look() == (
        [],
        ["provider /reset rosrpc://l:2", "service /reset /laser", "subscriber /scan /map"],
        False,
    )
    assert watcher.view.version == 8  # every change of state counts, also of types and URIs


def test_a_change_undone_between_two_calls_is_not_sent(api: MasterApi) -> None:
    watcher = Watcher(api)
    watcher.look()
    do(api, "/laser", "registerPublisher", "/scan", T, "http://l:1/")
    do(api, "/laser", "unregisterPublisher", "/scan", "http://l:1/")
    assert watcher.look() == ([], [], False)


def test_the_right_is_graph_on_the_master(api: MasterApi) -> None:
    who = caller("/watcher", {"/scan": Right.GRAPH})
    code, status, default = ask(api, who, WATCH, "", 0)
    assert (code, default) == (-1, {})
    assert status.startswith("rossec: /watcher needs the right graph on /master")


def test_only_visible_facts_are_sent(api: MasterApi) -> None:
    rights = {"/master": Right.GRAPH, "/scan": Right.SUBSCRIBE}
    watcher = Watcher(api, caller("/watcher", rights))
    do(api, "/laser", "registerPublisher", "/scan", T, "http://l:1/")
    do(api, "/secret", "registerPublisher", "/hidden", T, "http://s:1/")
    do(api, "/secret", "registerService", "/hide", "rosrpc://s:2", "http://s:1/")
    assert watcher.look()[0] == ["node /laser http://l:1/", "publisher /scan /laser", f"type /scan {T}"]
    watcher.who = caller("/watcher", {"/master": Right.GRAPH})  # a grant was revoked
    assert watcher.look() == (
        [],
        ["node /laser http://l:1/", "publisher /scan /laser", f"type /scan {T}"],
        False,
    )


def test_a_restarted_master_is_recognised(api: MasterApi) -> None:
    watcher = Watcher(api)
    do(api, "/laser", "registerPublisher", "/scan", T, "http://l:1/")
    watcher.look()
    watcher.api = master("second")
    do(watcher.api, "/laser", "registerPublisher", "/scan", T, "http://l:1/")
    assert watcher.look() == ([], [], True)  # the state is as before
    assert watcher.view.instance == "second"
    assert watcher.look() == ([], [], False)


def test_an_answer_is_bounded_and_the_rest_follows(api: MasterApi, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graph_calls, "BATCH", 2)
    for n in range(3):
        do(api, "/laser", "registerPublisher", f"/t{n}", "*", "http://l:1/")
    watcher = Watcher(api)
    assert len(watcher.look()[0]) == 2
    assert watcher.answer[2]["more"]
    assert len(watcher.look()[0]) == 2
    assert not watcher.answer[2]["more"]
    assert watcher.look() == ([], [], False)
    watcher.who = caller("/watcher", {"/master": Right.GRAPH})
    assert len(watcher.look()[1]) == 2
    assert watcher.answer[2]["more"]
    assert len(watcher.look()[1]) == 2


def test_watchers_of_one_identity_do_not_disturb_each_other(api: MasterApi) -> None:
    watchers = [Watcher(api) for _ in range(MAX_VIEWS)]
    assert [watcher.look()[2] for watcher in watchers] == [True] * MAX_VIEWS
    assert [watcher.look()[2] for watcher in watchers] == [False] * MAX_VIEWS
    Watcher(api).look()
    assert watchers[-1].look() == ([], [], False)
    assert watchers[0].look()[2]  # the oldest view was discarded
    assert len(api.graph.views) <= MAX_VIEWS


def test_views_of_disconnected_keys_are_discarded(api: MasterApi) -> None:
    watcher = Watcher(api)
    watcher.look()
    api.graph.views.keep_only(frozenset({watcher.who.thumbprint}))
    assert not watcher.look()[2]
    api.graph.views.keep_only(frozenset())
    assert watcher.look()[2]


@pytest.mark.parametrize("params", [("", "1"), (1, 1), ("", -1), ("", True), ("",), ("", 0, 0)])
def test_a_malformed_call_is_refused(api: MasterApi, params: tuple[object, ...]) -> None:
    answer: Any = call_api(api, WATCH, ["/watcher", *params], everything("/watcher"), 0).answer
    assert (answer[0], answer[2]) == (-1, {})
