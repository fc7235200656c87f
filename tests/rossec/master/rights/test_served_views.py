"""Answers about the graph show an alias to those who may see what is served of it."""

from collections.abc import Mapping

import pytest

from grants.model import Right
from rossec.master.rights import publisher_views
from rossec.master.rights.access_rules import AccessControl
from rossec.master.rights.caller import Caller
from rossec.master.state.registry import Kind
from tests.rossec.master.rights.serving import (
    ALIAS,
    GATEWAY,
    HOSPITAL,
    ORIGINS_RIGHT,
    POSE,
    SERVED,
    SERVED_RIGHT,
    Serving,
    node,
)

ROBOT = "/remote/hospital/robot"


@pytest.fixture
def master() -> Serving:
    master = Serving()
    master.imports.apply(HOSPITAL, POSE, [])
    master.serve()
    return master


def seen(master: Serving, who: Caller, kind: Kind = Kind.PUBLISHER) -> Mapping[str, object]:
    control = AccessControl(master.graph, "/master")
    found = publisher_views.shown_entries(master.graph, who, kind)
    shown = {key: control.visible_nodes(who, key, names) for key, names in found}
    return {key: names for key, names in shown.items() if names}


@pytest.mark.parametrize(
    ("own", "hospital", "expected"),
    [
        ({}, {}, {}),
        (SERVED_RIGHT, {}, {ALIAS: ("/gateway",), SERVED: ("/gateway",)}),
        ({SERVED: Right.GRAPH}, {}, {ALIAS: ("/gateway",), SERVED: ("/gateway",)}),
        ({}, ORIGINS_RIGHT, {ALIAS: (ROBOT,)}),
        (SERVED_RIGHT, ORIGINS_RIGHT, {ALIAS: (ROBOT, "/gateway"), SERVED: ("/gateway",)}),
        ({"/gateway/clinic/**": Right(255)}, {}, {}),
    ],
)
def test_who_sees_which_publishers(
    master: Serving, own: Mapping[str, Right], hospital: Mapping[str, Right], expected: Mapping[str, object]
) -> None:
    who = master.rights("/a", own, hospital)
    assert seen(master, who) == expected
    assert publisher_views.is_topic_visible(master.graph, who, ALIAS) is (ALIAS in expected)
    control = AccessControl(master.graph, "/master")
    assert control.is_node_visible(who, ROBOT) is (ROBOT in expected.get(ALIAS, ()))  # type: ignore[operator]
    assert control.is_node_visible(who, "/gateway") is (SERVED in expected)


def test_what_is_served_is_seen_though_no_site_reports_it(master: Serving) -> None:
    master.imports.drop("hospital")
    who = master.rights("/a", SERVED_RIGHT)
    assert seen(master, who) == {SERVED: ("/gateway",), ALIAS: ("/gateway",)}
    assert ALIAS not in seen(master, master.rights("/b", {}, ORIGINS_RIGHT))
    assert (ALIAS, "std_msgs/String") in list(master.graph.topic_types())


def test_a_gateway_sees_the_origins_nodes_alone(master: Serving) -> None:
    who = master.rights("/gateway", {"/gateway/**": Right(255)}, ORIGINS_RIGHT)
    assert seen(master, who)[ALIAS] == (ROBOT,)


def test_subscribers_here_are_seen_and_those_of_the_origin_are_not(master: Serving) -> None:
    master.imports.apply(HOSPITAL, [("subscriber", "/pose", "/robot")], [])
    master.registry.register_subscriber(ALIAS, "*", node("/viewer"))
    assert seen(master, master.rights("/a", SERVED_RIGHT), Kind.SUBSCRIBER) == {ALIAS: ("/viewer",)}
    assert seen(master, master.rights("/viewer", {}), Kind.SUBSCRIBER) == {ALIAS: ("/viewer",)}
    assert publisher_views.is_topic_visible(master.graph, master.callers["/viewer"], ALIAS)


def test_when_nothing_is_served_a_right_on_it_shows_nothing(master: Serving) -> None:
    who = master.rights("/a", SERVED_RIGHT)
    master.registry.remove_node("/gateway")
    assert seen(master, who) == {}
    assert not publisher_views.is_topic_visible(master.graph, who, ALIAS)


def test_a_gateway_that_does_not_answer_is_not_shown(master: Serving) -> None:
    """Under the served name neither: another gateway, which looks there, takes over."""
    who = master.rights("/a", SERVED_RIGHT)
    for silent in (True, False):
        assert master.registry.set_silent(GATEWAY, silent=silent)
        assert (SERVED in seen(master, who)) is not silent
        assert (ALIAS in seen(master, who)) is not silent
