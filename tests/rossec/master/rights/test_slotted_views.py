"""Who may know who publishes only to a slot is shown those of the slot's beginning."""

import pytest

from grants.model import Permission, Right
from rossec.master.rights import publisher_views
from rossec.master.state.graph import GraphNode
from rossec.master.state.registry import ANY_TYPE, Kind
from tests.rossec.master.rights.slotted import (
    FORWARDED_PORT,
    IN_SLOTS,
    SLOT,
    TYPE,
    URI,
    SlottedMaster,
    with_permissions,
)


@pytest.fixture
def master() -> SlottedMaster:
    return SlottedMaster()


def shown(master: SlottedMaster, now: int) -> list[tuple[str, tuple[str, ...]]]:
    master.graph.presence.now = now
    found = master.graph.entries(Kind.PUBLISHER)
    return list(publisher_views.shown_publishers(master.graph, master.watcher, found))


def test_a_publisher_is_shown_from_the_next_slot_to_the_end_of_its_last(master: SlottedMaster) -> None:
    graph, who = master.graph, master.watcher
    master.publish(65)
    assert shown(master, 119) == [(FORWARDED_PORT, ())]
    assert not publisher_views.is_published(graph, who, FORWARDED_PORT)
    assert not publisher_views.is_shown(graph, who, FORWARDED_PORT)
    assert publisher_views.topic_type(graph, who, FORWARDED_PORT) == ANY_TYPE
    assert publisher_views.node_uri(graph, who, "/sensor") is None
    assert [*publisher_views.shown_nodes(graph, who)] == [None]
    assert shown(master, 120) == [(FORWARDED_PORT, ("/sensor",))]
    assert publisher_views.topic_type(graph, who, FORWARDED_PORT) == TYPE
    master.end(130)
    assert shown(master, 179) == [(FORWARDED_PORT, ("/sensor",))]
    assert publisher_views.node_uri(graph, who, "/sensor") == URI
    assert [*publisher_views.topic_types(graph, who)] == [(FORWARDED_PORT, TYPE)]
    assert [*publisher_views.shown_nodes(graph, who)] == [GraphNode("/sensor", URI)]
    assert shown(master, 180) == [(FORWARDED_PORT, ())]
    assert publisher_views.node_uri(graph, who, "/sensor") is None


def test_a_new_address_is_shown_from_the_next_slot(master: SlottedMaster) -> None:
    master.publish(10)
    other = "http://10.0.0.5:2/"
    master.publish(70, other)
    master.graph.presence.now = 119
    assert publisher_views.node_uri(master.graph, master.watcher, "/sensor") == URI
    master.graph.presence.now = 120
    assert publisher_views.node_uri(master.graph, master.watcher, "/sensor") == other


def test_a_topic_with_a_subscriber_is_shown_but_has_no_type(master: SlottedMaster) -> None:
    master.subscribe(master.witness, 0)
    master.publish(5)
    assert publisher_views.is_shown(master.graph, master.watcher, FORWARDED_PORT)
    assert [*publisher_views.topic_types(master.graph, master.watcher)] == [None]


@pytest.mark.parametrize(
    "more",
    [
        Permission("/**", Right.GRAPH),
        Permission(FORWARDED_PORT, Right.SUBSCRIBE),
        Permission(FORWARDED_PORT, Right.PUBLISH),
    ],
    ids=str,
)
def test_any_other_right_shows_it_at_once(master: SlottedMaster, more: Permission) -> None:
    master.publish(65)
    master.graph.presence.now = 66
    who = with_permissions("/more", IN_SLOTS, more)
    assert publisher_views.is_published(master.graph, who, FORWARDED_PORT)
    assert publisher_views.topic_type(master.graph, who, FORWARDED_PORT) == TYPE
    assert who.slot(FORWARDED_PORT) == 0
    assert master.watcher.slot(FORWARDED_PORT) == SLOT


def test_without_slots_nothing_is_looked_up(master: SlottedMaster) -> None:
    master.publish(65)
    assert [*publisher_views.shown_nodes(master.graph, master.witness)] == []
    assert publisher_views.node_uri(master.graph, master.witness, "/sensor") is None
    assert [*publisher_views.topic_types(master.graph, master.witness)] == [(FORWARDED_PORT, TYPE)]
