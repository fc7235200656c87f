"""What local nodes want of other masters, in the origin's names, for as long as they want it."""

import pytest

from rossec.master.state import imports as module
from rossec.master.state.imported_facts import Site
from rossec.master.state.imports import EVERYTHING, NOTHING, WANTED_SECONDS, WantedNames
from rossec.master.state.registry import Kind, NodeRef, Registry

KITCHEN, HOSPITAL = Site("kitchen"), Site("ward", "hospital")
HERE = NodeRef("/here", "http://h:1/", b"here")


@pytest.fixture
def registry() -> Registry:
    return Registry()


@pytest.fixture
def demand(registry: Registry) -> WantedNames:
    return WantedNames(registry)


def test_nothing_is_wanted_at_first(demand: WantedNames) -> None:
    assert demand.wanted(KITCHEN, 0) == NOTHING


def test_subscribed_topics_are_wanted_while_they_are_subscribed(
    registry: Registry, demand: WantedNames
) -> None:
    registry.register_subscriber("/pose", "*", HERE)
    registry.register_subscriber("/remote/hospital/map", "*", HERE)
    registry.register_publisher("/own", "*", HERE)
    assert demand.wanted(KITCHEN, 10**9) == ("/gateway/hospital/map", "/pose")
    assert demand.wanted(HOSPITAL, 10**9) == ("/map",)
    registry.unregister(Kind.SUBSCRIBER, "/pose", HERE)
    registry.unregister(Kind.SUBSCRIBER, "/remote/hospital/map", HERE)
    assert demand.wanted(KITCHEN, 10**9) == NOTHING


def test_of_the_own_domain_what_gateways_there_serve_is_wanted(
    registry: Registry, demand: WantedNames
) -> None:
    for alias in ("/remote/kitchen/pose", "/remote/hospital/remote/clinic/map", "/remote/ward"):
        registry.register_subscriber(alias, "*", HERE)
    assert demand.wanted(KITCHEN, 0) == ("/gateway/kitchen/pose", "/pose")
    assert demand.wanted(HOSPITAL, 0) == ("/remote/clinic/map",)


def test_a_name_that_was_looked_up_is_wanted_for_a_minute(demand: WantedNames) -> None:
    demand.ask("/reset", 100)
    demand.ask("/remote/kitchen/robot", 100)
    demand.ask("/remote/hospital/robot", 100)
    demand.ask("/remote/hospital", 100)  # names nothing
    assert demand.wanted(KITCHEN, 100) == ("/reset", "/robot")
    assert demand.wanted(HOSPITAL, 100) == ("/robot",)
    assert demand.wanted(KITCHEN, 100 + WANTED_SECONDS - 1) == ("/reset", "/robot")
    assert demand.wanted(KITCHEN, 100 + WANTED_SECONDS) == NOTHING


def test_a_tool_that_lists_the_graph_wants_everything_for_a_minute(demand: WantedNames) -> None:
    demand.ask_everything(100)
    assert demand.wanted(KITCHEN, 100 + WANTED_SECONDS - 1) == EVERYTHING
    assert demand.wanted(KITCHEN, 100 + WANTED_SECONDS) == NOTHING


def test_the_version_grows_when_more_is_wanted_only(demand: WantedNames) -> None:
    def version_after(*asked: tuple[str, int]) -> int:
        for name, now in asked:
            demand.ask(name, now)
        return demand.version

    first = version_after(("/reset", 100))
    assert version_after(("/reset", 130)) == first  # still followed
    assert version_after(("/reset", 189)) == first
    second = version_after(("/reset", 300))
    assert second > first
    demand.ask_everything(300)
    third = demand.version
    assert third > second
    demand.ask_everything(359)
    assert demand.version == third


def test_a_topic_that_others_subscribe_is_wanted_already(registry: Registry, demand: WantedNames) -> None:
    for node in (HERE, NodeRef("/second", "http://h:2/", b"second")):
        registry.register_subscriber("/pose", "*", node)
    before = demand.version
    demand.ask("/pose", 100)
    assert demand.version == before


def test_what_is_asked_for_is_bounded(registry: Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_WANTED", 2)
    demand = WantedNames(registry)
    for name in ("/a", "/b", "/c"):
        demand.ask(name, 0)
    assert demand.wanted(KITCHEN, 0) == ("/b", "/c")


def test_more_than_fits_into_a_call_is_everything(
    registry: Registry, demand: WantedNames, monkeypatch: pytest.MonkeyPatch
) -> None:
    for topic in ("/a", "/b", "/c"):
        registry.register_subscriber(topic, "*", HERE)
    monkeypatch.setattr(module, "MAX_WANTED_BYTES", 5)
    assert demand.wanted(KITCHEN, 0) == EVERYTHING
    assert demand.wanted(HOSPITAL, 0) == NOTHING
