"""Each subscriber of an alias is told its own publishers, and only what is new to it."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from grants.model import Permission, Right
from rossec.master.state.registry import Kind, PublishersChanged
from tests.rossec.master.rights.serving import (
    ALIAS,
    GATEWAY,
    HOSPITAL,
    ORIGIN,
    ORIGINS_RIGHT,
    POSE,
    SERVED,
    SERVED_RIGHT,
    Serving,
    T,
    node,
)
from tests.rossec.master.rights.slotted import (
    FORWARDED_PORT,
    IN_SLOTS,
    SLOT,
    URI,
    SlottedMaster,
    with_permissions,
)

BOTH = (SERVED_RIGHT, ORIGINS_RIGHT)


@pytest.fixture
def master() -> Serving:
    master = Serving()
    master.imports.apply(HOSPITAL, POSE, [])
    return master


def lists(updates: list[PublishersChanged]) -> dict[str, list[str]]:
    """By subscriber; of the alias."""
    return {
        each.name: list(update.publisher_uris)
        for update in updates
        if update.topic == ALIAS
        for each in update.subscribers
    }


def test_each_is_told_what_its_rights_are_about(master: Serving) -> None:
    assert master.subscribe("/served", SERVED_RIGHT) == []
    assert master.subscribe("/origins", {}, ORIGINS_RIGHT) == [ORIGIN]
    assert master.subscribe("/both", *BOTH) == [ORIGIN]
    assert lists(master.serve()) == {"/served": [GATEWAY.uri], "/both": [GATEWAY.uri]}
    assert master.subscribe("/late", *BOTH) == [GATEWAY.uri]
    assert master.subscribe("/other", {}, ORIGINS_RIGHT) == [ORIGIN]
    gone = master.updates(list(master.registry.remove_node("/gateway")))
    assert lists(gone) == {"/served": [], "/both": [ORIGIN], "/late": [ORIGIN]}


def test_a_gateway_itself_is_told_the_origin(master: Serving) -> None:
    master.serve()
    everything = {"/**": SERVED_RIGHT[SERVED], **SERVED_RIGHT}
    assert master.subscribe("/gateway", everything, ORIGINS_RIGHT) == [ORIGIN]
    assert master.subscribe("/gateway/attic", everything) == []


def test_other_topics_have_one_list_for_all(master: Serving) -> None:
    who = master.rights("/a", {})
    master.registry.register_publisher("/own", T, node("/bb"))
    assert master.aliases.tell(who, "/own", node("/a")) == [node("/bb").uri]
    assert len(master.aliases) == 0
    event = PublishersChanged("/own", (node("/a"),), ("http://x:1/",))
    assert master.aliases.updates(event, 0) == (event,)
    strange = PublishersChanged("/gateway/state", (node("/a"),), ("http://x:1/",))
    assert master.aliases.updates(strange, 0) == (strange,)


def test_direct_subscribers_of_a_served_name_are_told_as_ever(master: Serving) -> None:
    master.registry.register_subscriber(SERVED, "*", node("/direct"))
    (update,) = master.serve()
    assert update == PublishersChanged(SERVED, (node("/direct"),), (GATEWAY.uri,))


def test_who_is_told_the_gateway_hears_no_changes_at_the_origin(master: Serving) -> None:
    master.serve()
    master.subscribe("/served", SERVED_RIGHT)
    master.subscribe("/both", *BOTH)
    master.subscribe("/origins", {}, ORIGINS_RIGHT)
    moved = [("node", "/robot", "http://10.0.0.7:1/")]
    events = master.imports.apply(HOSPITAL, moved, [POSE[0]])
    assert lists(master.updates([*events])) == {"/origins": ["http://10.0.0.7:1/"]}


def test_a_silent_gateway_is_left_until_it_answers(master: Serving) -> None:
    master.serve()
    master.subscribe("/served", SERVED_RIGHT)
    master.subscribe("/both", *BOTH)
    assert master.registry.set_silent(GATEWAY, silent=True)
    assert lists(master.aliases.changes(SERVED, 0)) == {"/served": [], "/both": [ORIGIN]}
    assert master.aliases.changes(SERVED, 0) == []
    assert master.registry.set_silent(GATEWAY, silent=False)
    assert lists(master.aliases.changes(ALIAS, 0)) == {"/served": [GATEWAY.uri], "/both": [GATEWAY.uri]}


def test_rights_that_come_and_go_change_the_list(master: Serving) -> None:
    master.serve()
    assert master.subscribe("/a", {}, ORIGINS_RIGHT) == [ORIGIN]
    master.rights("/a", *BOTH)
    assert lists(master.aliases.changes_for("/a", 0)) == {"/a": [GATEWAY.uri]}
    assert master.aliases.changes_for("/a", 0) == []
    master.rights("/a", SERVED_RIGHT)
    assert master.aliases.changes_for("/a", 0) == []
    master.rights("/a", {})
    ((update,),) = list(master.aliases.all_changes(0))
    assert lists([update]) == {"/a": []}


def test_anonymous_nodes_are_found_by_their_certified_name(master: Serving) -> None:
    master.subscribe("/rviz_1", {}, ORIGINS_RIGHT)
    master.serve()
    master.rights("/rviz_1", *BOTH)
    assert master.aliases.changes_for("/rvi", 0) == []
    assert lists(master.aliases.changes_for("/rviz", 0)) == {"/rviz_1": [GATEWAY.uri]}


def test_of_a_revoked_node_nothing_is_said(master: Serving) -> None:
    master.subscribe("/both", *BOTH)
    del master.callers["/both"]
    assert lists(master.serve()) == {}


def test_a_node_that_registers_anew_is_told_anew(master: Serving) -> None:
    master.subscribe("/both", *BOTH)
    master.serve()
    elsewhere = node("/both")._replace(uri="http://10.0.9.9:1/")
    master.registry.register_subscriber(ALIAS, "*", elsewhere)
    (update,) = master.aliases.changes(ALIAS, 0)
    assert update == PublishersChanged(ALIAS, (elsewhere,), (GATEWAY.uri,))
    assert len(master.aliases) == 1


def test_what_is_not_registered_is_forgotten(master: Serving) -> None:
    for name in ("/a", "/bb", "/ccc"):
        master.subscribe(name, *BOTH)
    assert len(master.aliases) == 3
    master.registry.unregister(Kind.SUBSCRIBER, ALIAS, node("/a"))
    master.aliases.forget(ALIAS, "/a")
    master.aliases.forget(ALIAS, "/unknown")
    assert len(master.aliases) == 2
    master.registry.remove_node("/bb")
    assert not any(master.aliases.all_changes(0))
    assert len(master.aliases) == 1
    master.registry.register_subscriber(ALIAS, "*", node("/ccc")._replace(uri="http://10.0.9.9:1/"))
    assert not any(master.aliases.all_changes(0))
    assert len(master.aliases) == 0


@given(st.booleans(), st.booleans(), st.booleans(), st.booleans())
def test_nobody_is_told_what_it_has_no_right_to(
    own: bool, origins: bool, serves: bool, published: bool
) -> None:
    master = Serving()
    if published:
        master.imports.apply(HOSPITAL, POSE, [])
    if serves:
        master.serve()
    told = master.subscribe("/a", SERVED_RIGHT if own else {}, ORIGINS_RIGHT if origins else {})
    expected = [GATEWAY.uri] if own and serves else [ORIGIN] if origins and published else []
    assert told == expected


class Telling(RuleBasedStateMachine):
    """Whatever happens in whatever order, each has been sent what it would be told now."""

    def __init__(self) -> None:
        super().__init__()
        self.master = Serving()
        self.known: dict[str, list[str]] = {}

    def deliver(self, updates: list[PublishersChanged]) -> None:
        for name, uris in lists(updates).items():
            assert self.known[name] != uris
            self.known[name] = uris

    def registry(self, events: list[Any]) -> None:
        self.deliver(self.master.updates(events))

    @rule(name=st.sampled_from(["/a", "/bb"]), own=st.booleans(), origins=st.booleans())
    def subscribe(self, name: str, own: bool, origins: bool) -> None:
        given = SERVED_RIGHT if own else {}, ORIGINS_RIGHT if origins else {}
        self.known[name] = self.master.subscribe(name, *given)

    @rule(name=st.sampled_from(["/a", "/bb"]), own=st.booleans(), origins=st.booleans())
    def change_rights(self, name: str, own: bool, origins: bool) -> None:
        self.master.rights(name, SERVED_RIGHT if own else {}, ORIGINS_RIGHT if origins else {})
        self.deliver(self.master.aliases.changes_for(name, 0))

    @rule(name=st.sampled_from(["/a", "/bb"]))
    def unsubscribe(self, name: str) -> None:
        self.master.registry.unregister(Kind.SUBSCRIBER, ALIAS, node(name))
        self.master.aliases.forget(ALIAS, name)
        self.known.pop(name, None)

    @rule()
    def serve(self) -> None:
        self.deliver(self.master.serve())

    @rule()
    def stop_serving(self) -> None:
        self.registry([*self.master.registry.remove_node("/gateway")])

    @rule(silent=st.booleans())
    def answer(self, silent: bool) -> None:
        if self.master.registry.set_silent(GATEWAY, silent=silent):
            self.deliver(self.master.aliases.changes(SERVED, 0))

    @rule(published=st.booleans())
    def import_facts(self, published: bool) -> None:
        facts = POSE if published else []
        self.registry([*self.master.imports.apply(HOSPITAL, facts, [], whole=True)])

    @invariant()
    def everybody_knows(self) -> None:
        for name, uris in self.known.items():
            assert uris == self.master.aliases.uris(self.master.callers[name], ALIAS)
        assert len(self.master.aliases) == len(self.known)


TestTelling = Telling.TestCase


def test_who_is_in_slots_is_told_at_the_beginning_of_the_next() -> None:
    """The others at once; a slot that is new brings the next round of maintenance forward."""
    master, sooner = SlottedMaster(), list[int]()
    master.aliases.on_slot = lambda: sooner.append(SLOT)
    assert master.aliases.next_slot(0) is None
    for who in (master.watcher, master.witness):
        assert master.subscribe(who, 5) == []
    assert (master.aliases.next_slot(5), sooner) == (60, [SLOT])
    master.publish(65)
    master.maintain(119)
    assert master.sent == {"/witness": [(65, [URI])]}
    master.maintain(120)
    assert master.sent["/watcher"] == [(120, [URI])]
    assert (master.aliases.next_slot(120), sooner) == (180, [SLOT])


def test_a_further_grant_is_in_force_at_once() -> None:
    master = SlottedMaster()
    master.subscribe(master.watcher, 5)
    master.publish(65)
    more = with_permissions("/watcher", IN_SLOTS, Permission(FORWARDED_PORT, Right.SUBSCRIBE))
    master.statements.callers["/watcher"] = more
    assert [each.publisher_uris for each in master.aliases.changes_for("/watcher", 66)] == [(URI,)]
    master.end(70)
    assert master.sent["/watcher"] == [(70, [])]


def test_without_subscribers_no_slot_is_waited_for() -> None:
    master = SlottedMaster()
    master.subscribe(master.watcher, 5)
    master.registry.remove_node("/watcher")
    for now in (10, 20):
        master.maintain(now)
    assert master.aliases.next_slot(20) is None
