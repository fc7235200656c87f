"""Queries see what other masters have registered; nothing below /remote is registered here."""

from dataclasses import replace
from typing import Any

import pytest

from ca.names import origin_of
from grants.decision import Reach
from grants.model import Permission, Right
from rossec.master.api.graph_calls import WATCH
from rossec.master.rights.caller import Caller
from rossec.master.state.imported_facts import Site
from rossec.master.state.imports import EVERYTHING, NOTHING, Imports
from rossec.master.state.registry import Registry
from tests.rossec.master.fakes import FakeStatements, call_api, caller, everything, master_api

T, URI = "std_msgs/String", "http://10.0.0.2:1/"
FACTS = [
    ("node", "/robot", URI),
    ("publisher", "/pose", "/robot"),
    ("type", "/pose", T),
    ("service", "/reset", "/robot"),
    ("provider", "/reset", "rosrpc://10.0.0.2:9"),
]
KITCHEN, HOSPITAL = Site("kitchen"), Site("hospital", "hospital")


GUEST = "/remote/clinic/nurse"


class Importing:
    def __init__(self) -> None:
        self.registry = Registry()
        self.imports = Imports(self.registry)
        self.api = master_api(
            self.registry, FakeStatements(), name="/master", uri="http://m:1/", pid=7, imports=self.imports
        )
        self.tool = everything("/tool")

    def ask(self, method: str, *params: object, who: Caller | None = None) -> Any:
        who = who or self.tool
        name = origin_of(who.name)
        return call_api(self.api, method, [name, *params], who, 0).answer


@pytest.fixture
def master() -> Importing:
    master = Importing()
    master.imports.apply(KITCHEN, FACTS, [])
    return master


def test_queries_see_local_and_imported_facts(master: Importing) -> None:
    master.ask("registerPublisher", "/pose", "*", "http://10.0.0.1:1/")
    robot = "/remote/kitchen/robot"
    assert master.ask("getSystemState")[2] == [[["/pose", ["/tool", robot]]], [], [["/reset", [robot]]]]
    assert master.ask("getPublishedTopics", "")[2] == [["/pose", T]]
    assert master.ask("getTopicTypes")[2] == [["/pose", T]]
    assert master.ask("lookupService", "/reset")[2] == "rosrpc://10.0.0.2:9"
    assert master.ask("lookupNode", robot)[2] == URI
    facts = master.ask(WATCH, "", 0)[2]["added"]
    assert ["publisher", "/pose", robot] in facts
    assert ["node", robot, URI] in facts
    assert ["provider", "/reset", "rosrpc://10.0.0.2:9"] in facts


def test_a_subscriber_is_answered_with_imported_publishers(master: Importing) -> None:
    assert master.ask("registerSubscriber", "/pose", T, "http://10.0.0.1:1/")[2] == [URI]


def test_foreign_names_are_below_their_label(master: Importing) -> None:
    master.imports.drop("kitchen")
    master.imports.apply(HOSPITAL, FACTS, [])
    assert master.ask("getSystemState")[2][0] == [["/remote/hospital/pose", ["/remote/hospital/robot"]]]


def test_a_caller_sees_no_import_without_a_right(master: Importing) -> None:
    nobody = caller("/nobody")
    assert master.ask("getSystemState", who=nobody)[2] == [[], [], []]
    assert master.ask("lookupNode", "/remote/kitchen/robot", who=nobody)[0] == -1
    assert master.ask("getTopicTypes", who=nobody)[2] == []


def test_a_cached_state_ends_with_a_change_of_the_imports(master: Importing) -> None:
    first = master.ask("getSystemState")[2]
    assert master.ask("getSystemState")[2] is first
    master.imports.drop("kitchen")
    assert master.ask("getSystemState")[2] == [[], [], []]


@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("registerPublisher", ("/remote/kitchen/x", T, "http://10.0.0.1:1/")),
        ("registerService", ("/remote/kitchen/x", "rosrpc://10.0.0.1:2", "http://10.0.0.1:1/")),
        ("registerPublisher", ("/remote", T, "http://10.0.0.1:1/")),
    ],
)
def test_nothing_below_remote_is_offered_here(
    master: Importing, method: str, params: tuple[str, ...]
) -> None:
    code, status, _ = master.ask(method, *params)
    assert code == -1
    assert "publish or provide it under a name of this domain" in status
    assert master.registry.version == 0


def test_what_is_asked_for_is_wanted_of_other_masters(master: Importing) -> None:
    def wanted() -> tuple[str, ...]:
        return master.imports.demand.wanted(KITCHEN, 0)

    assert wanted() == NOTHING
    master.ask("registerSubscriber", "/map", "*", "http://10.0.0.1:1/")
    assert wanted() == ("/map",)
    master.ask("lookupService", "/stop")
    master.ask("lookupNode", "/remote/kitchen/arm")
    master.ask("lookupNode", "/tool")  # is registered here
    assert wanted() == ("/arm", "/map", "/stop")
    master.ask("getSystemState")
    assert wanted() == EVERYTHING


@pytest.mark.parametrize(
    ("method", "params"), [("getTopicTypes", ()), ("getPublishedTopics", ("",)), (WATCH, ("", 0))]
)
def test_a_tool_that_lists_wants_everything(
    master: Importing, method: str, params: tuple[object, ...]
) -> None:
    master.ask(method, *params)
    assert master.imports.demand.wanted(KITCHEN, 0) == EVERYTHING


def visitor(exported: str = "/**") -> Caller:
    """A foreigner with every grant, from whose domain nothing else is exported."""
    found = everything(GUEST)
    return replace(found, exported=Reach([Permission(exported, Right.SUBSCRIBE | Right.GRAPH)]))


@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("getSystemState", ()),
        ("getTopicTypes", ()),
        ("getPublishedTopics", ("",)),
        (WATCH, ("", 0)),
        ("lookupNode", ("/remote/kitchen/arm",)),
        ("lookupNode", ("/arm",)),
    ],
)
def test_a_foreigner_has_nothing_asked_of_other_masters(
    master: Importing, method: str, params: tuple[object, ...]
) -> None:
    before = master.imports.demand.version
    master.ask(method, *params, who=visitor())
    assert master.imports.demand.version == before
    assert master.imports.demand.wanted(KITCHEN, 0) == NOTHING


def test_a_foreigner_is_shown_no_node_of_another_origin(master: Importing) -> None:
    guest, nurse = everything("/remote/hospital/robot3"), visitor()
    master.ask("registerSubscriber", "/pose", T, "http://10.0.0.3:1/", who=guest)
    master.ask("registerSubscriber", "/pose", T, "http://10.0.0.4:1/", who=nurse)
    master.ask("registerPublisher", "/pose", T, "http://10.0.0.1:1/")
    state = master.ask("getSystemState", who=nurse)[2]
    assert state == [[["/pose", ["/tool"]]], [["/pose", [GUEST]]], []]
    facts = master.ask(WATCH, "", 0, who=nurse)[2]["added"]
    assert not [fact for fact in facts if "kitchen" in str(fact) or "hospital" in str(fact)]
    for name in ("/remote/kitchen/robot", "/remote/hospital/robot3"):
        assert master.ask("lookupNode", name, who=nurse)[0] == -1
    assert master.ask("lookupNode", "/tool", who=nurse)[2] == "http://10.0.0.1:1/"
    assert master.ask("lookupNode", GUEST, who=nurse)[2] == "http://10.0.0.4:1/"


def test_a_foreigner_is_shown_no_node_that_is_not_exported(master: Importing) -> None:
    master.ask("registerPublisher", "/pose", T, "http://10.0.0.1:1/")
    lamp = visitor("/lamp/**")
    assert master.ask("lookupNode", "/tool", who=lamp)[0] == -1
    assert not master.ask(WATCH, "", 0, who=lamp)[2]["added"]
