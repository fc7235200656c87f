"""The facts of one site: checked, indexed, withdrawn without a trace."""

import pytest

from rossec.errors import ImportRefused
from rossec.master.state.imported_facts import Fact, Site, SiteFacts, checked
from rossec.master.state.registry import Kind

ROBOT = ("node", "/robot", "http://10.0.0.2:1/")
FACTS: list[Fact] = [
    ROBOT,
    ("publisher", "/pose", "/robot"),
    ("subscriber", "/cmd", "/robot"),
    ("type", "/pose", "std_msgs/String"),
    ("service", "/reset", "/robot"),
    ("provider", "/reset", "rosrpc://10.0.0.2:9"),
]


@pytest.fixture
def held() -> SiteFacts:
    return SiteFacts(Site("kitchen"))


def test_well_formed_facts_are_taken_as_they_are() -> None:
    assert checked(FACTS) == FACTS


@pytest.mark.parametrize(
    ("fact", "why"),
    [
        (("publisher", "/a", "robot"), "invalid name"),
        (("node", "/remote/a/b", "x"), "alias"),
        (("provider", "/a", "rosrpc://10.0.0.2"), "not one"),
        (("kind", "/a", "/b"), "unknown kind"),
        (("type", "/a", "a/" + "b" * 300), "not one"),
        (("node", "/a", "http://x:1/ "), "not one"),
    ],
)
def test_a_malformed_fact_is_refused(fact: Fact, why: str) -> None:
    with pytest.raises(ImportRefused, match=why):
        checked([*FACTS, fact])


def test_facts_are_found_by_what_they_are_about(held: SiteFacts) -> None:
    for fact in FACTS:
        held.add(fact)
    assert held.nodes["/robot"].name == "/remote/kitchen/robot"
    assert held.nodes["/robot"].endpoint == ("10.0.0.2", 1)
    assert held.types == {"/pose": "std_msgs/String"}
    assert held.providers["/reset"].uri == "rosrpc://10.0.0.2:9"
    kinds = sorted((each.kind.value, each.key) for each in held.registered["/robot"])
    assert kinds == [("publisher", "/pose"), ("service", "/reset"), ("subscriber", "/cmd")]


def test_what_is_withdrawn_leaves_nothing(held: SiteFacts) -> None:
    for fact in FACTS:
        held.add(fact)
    for fact in FACTS:
        held.remove(fact)
    assert not any((held.facts, held.nodes, held.registered, held.types, held.providers))


def test_a_newer_value_stays_when_the_older_one_is_withdrawn(held: SiteFacts) -> None:
    older: list[Fact] = [ROBOT, ("type", "/pose", "a/Old"), ("provider", "/s", "rosrpc://h:1")]
    newer: list[Fact] = [
        ("node", "/robot", "http://10.0.0.3:1/"),
        ("type", "/pose", "a/New"),
        ("provider", "/s", "rosrpc://h:2"),
    ]
    for fact in (*older, *newer):
        held.add(fact)
    for fact in older:
        held.remove(fact)
    assert held.nodes["/robot"].uri == "http://10.0.0.3:1/"
    assert held.types == {"/pose": "a/New"}
    assert held.providers["/s"].uri == "rosrpc://h:2"


def test_a_registration_is_one_of_a_known_kind(held: SiteFacts) -> None:
    found = held.registration(FACTS[1])
    assert found is not None
    assert (found.kind, found.key) == (Kind.PUBLISHER, "/pose")
    assert held.registration(ROBOT) is None
    assert held.local_key("/" + "n" * 300) is None


def test_topics_are_those_published_or_subscribed_there(held: SiteFacts) -> None:
    for fact in FACTS:
        held.add(fact)
    assert held.topics() == ["/cmd", "/pose"]


def test_below_gateway_only_gateways_are_registered(held: SiteFacts) -> None:
    served = "/gateway/hospital/pose"
    assert held.registration(("publisher", served, "/robot")) is None
    assert held.registration(("service", served, "/gateway_1")) is None
    for kind, node in (("publisher", "/gateway"), ("subscriber", "/robot")):
        found = held.registration((kind, served, node))
        assert found is not None
        assert found.key == served


def test_the_names_that_facts_are_about(held: SiteFacts) -> None:
    for fact in FACTS:
        held.add(fact)
    assert held.keys([("type", "/map", "a/Map"), ("node", "/nobody", "http://h:1/")]) == {"/map"}
    assert held.keys([ROBOT]) == {each.key for each in held.registered["/robot"]}
    assert held.keys([("type", "/" + "n" * 300, "a/Map")]) == set()
