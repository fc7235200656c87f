"""The caches of graph queries; the answers are compared in test_differential."""

from typing import Any

import pytest

from rossec.master.api.dispatch import MasterApi
from rossec.master.rights.access_rules import Caller
from rossec.master.state.registry import Registry
from tests.rossec.master.fakes import FakeStatements, call_api, caller, everything

EMPTY: list[object] = [[], [], []]


@pytest.fixture
def api() -> MasterApi:
    return MasterApi(Registry(), FakeStatements(), name="/master", uri="http://m:1/", pid=7)


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
def test_the_caches_are_bounded(
    api: MasterApi, monkeypatch: pytest.MonkeyPatch, limit: str
) -> None:
    monkeypatch.setattr(f"rossec.master.api.graph_calls.{limit}", 2)
    for number in range(5):
        register(api, "/a", f"/t{number}")
    for number in range(5):
        assert len(state(api, everything(f"/viewer{number}"))[0]) == 5
    handler: Any = api.methods["getSystemState"].handler
    assert len(handler.__self__._states) <= (2 if limit == "_MAX_CACHED_STATES" else 5)
    assert len(handler.__self__._entries) <= (2 if limit == "_MAX_CACHED_ENTRIES" else 5)
