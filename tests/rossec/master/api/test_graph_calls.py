"""What is registered, found and shown; test_differential compares the answers with stock's."""

from typing import Any

import pytest

from rossec.master.api.dispatch import MasterApi
from rossec.master.rights.caller import Caller
from rossec.master.state.registry import Registry
from tests.rossec.master.fakes import FakeStatements, call_api, caller, everything, master_api

EMPTY: list[object] = [[], [], []]


@pytest.fixture
def api() -> MasterApi:
    return master_api(Registry(), FakeStatements(), name="/master", uri="http://m:1/", pid=7)


def state(api: MasterApi, who: Caller) -> Any:
    return call_api(api, "getSystemState", [who.name], who, 0).answer[2]  # type: ignore[index]


def register(api: MasterApi, name: str, topic: str) -> None:
    params = [name, topic, "*", f"http://{name[1:]}:1/"]
    call_api(api, "registerPublisher", params, everything(name), 0)


def test_the_same_caller_receives_changes(api: MasterApi) -> None:
    who = everything("/viewer")
    assert state(api, who) == EMPTY
    register(api, "/a", "/t")
    first = state(api, who)
    assert first == [[["/t", ["/a"]]], [], []]
    assert state(api, who) is first
    call_api(api, "unregisterPublisher", ["/a", "/t", "http://a:1/"], everything("/a"), 0)
    assert state(api, who) == EMPTY


def test_a_cached_state_is_not_sent_to_another_caller(api: MasterApi) -> None:
    """The cache key is the id of an object, which may be reused."""
    register(api, "/a", "/t")
    rich, poor = everything("/rich"), caller("/poor")
    assert state(api, rich) != EMPTY
    handler: Any = api.methods["getSystemState"].handler
    handler.__self__._states[id(poor)] = handler.__self__._states[id(rich)]
    assert state(api, poor) == EMPTY


@pytest.mark.parametrize("limit", ["_MAX_CACHED_STATES", "_MAX_CACHED_ENTRIES"])
def test_the_caches_are_bounded(api: MasterApi, monkeypatch: pytest.MonkeyPatch, limit: str) -> None:
    monkeypatch.setattr(f"rossec.master.api.graph_calls.{limit}", 2)
    for number in range(5):
        register(api, "/a", f"/t{number}")
    for number in range(5):
        assert len(state(api, everything(f"/viewer{number}"))[0]) == 5
    handler: Any = api.methods["getSystemState"].handler
    assert len(handler.__self__._states) <= (2 if limit == "_MAX_CACHED_STATES" else 5)
    assert len(handler.__self__._entries) <= (2 if limit == "_MAX_CACHED_ENTRIES" else 5)


def answer(api: MasterApi, who: Caller, method: str, *params: object) -> Any:
    return call_api(api, method, [who.name, *params], who, 0).answer


def test_publishers_and_subscribers_find_each_other(api: MasterApi) -> None:
    a, b = everything("/a"), everything("/b")
    uri_a, uri_b = "http://a:1/", "http://b:1/"
    assert answer(api, b, "registerSubscriber", "/t", "*", uri_b) == [1, "Subscribed to [/t]", []]
    registered = [1, "Registered [/a] as publisher of [/t]", [uri_b]]
    assert answer(api, a, "registerPublisher", "/t", "std_msgs/String", uri_a) == registered
    assert answer(api, b, "registerSubscriber", "/t", "*", uri_b)[2] == [uri_a]
    assert answer(api, b, "unregisterSubscriber", "/t", uri_b)[2] == 1
    assert answer(api, b, "unregisterSubscriber", "/t", uri_b)[2] == 0
    assert answer(api, a, "unregisterPublisher", "/t", "http://elsewhere:1/")[2] == 0
    assert answer(api, a, "unregisterPublisher", "/t", uri_a)[2] == 1


def test_a_service_has_one_provider_until_it_is_unregistered(api: MasterApi) -> None:
    a, uri = everything("/a"), "rosrpc://a:2"
    assert answer(api, a, "lookupService", "/s") == [-1, "no provider", ""]
    registered = [1, "Registered [/a] as provider of [/s]", 1]
    assert answer(api, a, "registerService", "/s", uri, "http://a:1/") == registered
    assert answer(api, a, "lookupService", "/s") == [1, f"rosrpc URI: [{uri}]", uri]
    assert answer(api, a, "unregisterService", "/s", uri)[2] == 1
    assert answer(api, a, "lookupService", "/s")[0] == -1


def test_a_node_is_found_by_those_who_may_see_it(api: MasterApi) -> None:
    register(api, "/a", "/t")
    viewer = everything("/viewer")
    assert answer(api, viewer, "lookupNode", "/a") == [1, "node api", "http://a:1/"]
    unknown = [-1, "unknown node [/a]", ""]
    assert answer(api, caller("/poor"), "lookupNode", "/a") == unknown
    assert answer(api, viewer, "lookupNode", "/b") == [-1, "unknown node [/b]", ""]


def test_topics_are_shown_with_their_types_to_those_who_may_see_them(api: MasterApi) -> None:
    for topic in ("/ns/t", "/other"):
        register(api, "/a", topic)
    viewer, types = everything("/viewer"), [["/ns/t", "*"], ["/other", "*"]]
    assert sorted(answer(api, viewer, "getTopicTypes")[2]) == types
    assert sorted(answer(api, viewer, "getPublishedTopics", "")[2]) == types
    assert answer(api, viewer, "getPublishedTopics", "/ns")[2] == [["/ns/t", "*"]]
    assert answer(api, caller("/poor"), "getTopicTypes")[2] == []
    own = caller("/a")
    assert sorted(answer(api, own, "getTopicTypes")[2]) == types  # what it registered itself
