"""Queries over the own registrations and the imports together."""

import pytest

from rossec.master.state.graph import Graph, GraphNode
from rossec.master.state.imported_facts import Site
from rossec.master.state.imports import Imports
from rossec.master.state.registry import Kind, NodeRef, Registry

T, KITCHEN = "std_msgs/String", Site("kitchen")
HERE = NodeRef("/here", "http://10.0.0.1:1/", b"here")
ROBOT = "/remote/kitchen/robot"
FACTS = [
    ("node", "/robot", "http://10.0.0.2:1/"),
    ("publisher", "/pose", "/robot"),
    ("publisher", "/far", "/robot"),
    ("type", "/pose", T),
    ("type", "/far", T),
    ("service", "/reset", "/robot"),
    ("provider", "/reset", "rosrpc://10.0.0.2:9"),
]


@pytest.fixture
def graph() -> Graph:
    registry = Registry()
    graph = Graph(registry, Imports(registry))
    registry.register_publisher("/pose", "*", HERE)
    graph.imports.apply(KITCHEN, FACTS, [])
    return graph


def test_a_topic_occurs_once_with_the_nodes_of_all_masters(graph: Graph) -> None:
    assert list(graph.entries(Kind.PUBLISHER)) == [("/pose", ("/here", ROBOT)), ("/far", (ROBOT,))]
    assert list(graph.entries(Kind.SERVICE)) == [("/reset", (ROBOT,))]
    assert list(graph.entries(Kind.SUBSCRIBER)) == []


def test_nodes_are_found_here_and_elsewhere(graph: Graph) -> None:
    uri = "http://10.0.0.2:1/"
    assert list(graph.nodes()) == [GraphNode("/here", HERE.uri), GraphNode(ROBOT, uri)]
    assert [graph.node_uri(name) for name in ("/here", ROBOT, "/robot")] == [HERE.uri, uri, None]
    assert graph.keys_of("/here", Kind.PUBLISHER) == ("/pose",)
    assert sorted(graph.keys_of(ROBOT, Kind.PUBLISHER)) == ["/far", "/pose"]
    assert graph.service_uri("/reset") == "rosrpc://10.0.0.2:9"


def test_the_type_of_a_topic_is_the_own_one_where_it_is_known(graph: Graph) -> None:
    assert graph.topic_type("/pose") == T
    assert sorted(graph.topic_types()) == [("/far", T), ("/pose", T)]
    graph.registry.register_publisher("/pose", "a/Other", HERE)
    assert graph.topic_type("/pose") == "a/Other"
    assert next(iter(graph.entries(Kind.PUBLISHER))) == ("/pose", ("/here",))


def test_what_hides_everything_of_a_name_hides_the_name(graph: Graph) -> None:
    graph.registry.register_publisher("/x", T, NodeRef("/robot", "http://10.0.0.1:2/", b"robot"))
    assert dict(graph.entries(Kind.PUBLISHER)) == {"/pose": ("/here",), "/x": ("/robot",)}
    assert graph.node_uri(ROBOT) is None


def test_the_version_grows_with_both(graph: Graph) -> None:
    before = graph.version
    graph.registry.register_publisher("/new", T, HERE)
    middle = graph.version
    graph.imports.drop("kitchen")
    assert before < middle < graph.version
