"""A contradiction of types is reported once, until its site is forgotten."""

import pytest

from rossec.master.state import imported_facts
from rossec.master.state.imported_facts import Contradictions, Fact, Site, SiteFacts, TypeContradicted
from rossec.master.state.registry import NodeRef, Registry

HERE, THERE = "std_msgs/String", "std_msgs/Int32"
FACTS: list[Fact] = [
    ("type", "/a", THERE),
    ("type", "/b", THERE),
    ("type", "/same", HERE),
    ("type", "/far", THERE),
    ("publisher", "/a", "/robot"),
]


@pytest.fixture
def registry() -> Registry:
    registry, node = Registry(), NodeRef("/n", "http://h:1/", b"n")
    for topic in ("/a", "/b", "/same"):
        registry.register_publisher(topic, HERE, node)
    return registry


def test_each_topic_is_reported_once_for_a_site(registry: Registry) -> None:
    found, kitchen = Contradictions(registry), SiteFacts(Site("kitchen"))
    assert found.report(kitchen, FACTS) == [
        TypeContradicted("kitchen", topic, HERE, THERE) for topic in ("/a", "/b")
    ]
    assert found.report(kitchen, FACTS) == []
    assert len(found.report(SiteFacts(Site("attic")), FACTS)) == 2
    found.forget("kitchen")
    found.forget("nobody")
    assert len(found.report(kitchen, FACTS)) == 2


def test_of_an_alias_nobody_here_says_what_type_it_has(registry: Registry) -> None:
    registry.register_subscriber("/remote/hospital/a", HERE, NodeRef("/n", "http://h:1/", b"n"))
    hospital = SiteFacts(Site("hospital", "hospital"))
    assert Contradictions(registry).report(hospital, FACTS) == []


def test_reports_of_one_site_are_bounded(registry: Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(imported_facts, "MAX_REPORTED", 1)
    assert len(Contradictions(registry).report(SiteFacts(Site("kitchen")), FACTS)) == 1
