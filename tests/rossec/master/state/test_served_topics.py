"""What gateways serve: theirs and those of other masters, unless they are silent."""

import pytest

from grants.decision import Reach
from grants.model import Permission, Right
from rossec.master.state.graph import Graph
from rossec.master.state.imported_facts import Site
from rossec.master.state.imports import Imports
from rossec.master.state.registry import Kind, NodeRef, Registry
from tests.rossec.master.state.test_imports import HERE, HOSPITAL, KITCHEN, OTHER, T

ALIAS, SERVED = "/remote/hospital/pose", "/gateway/hospital/pose"
GATEWAY = NodeRef("/gateway", "http://10.0.0.9:1/", b"gateway")
ELSEWHERE = [
    ("node", "/gateway/attic", "http://10.0.0.3:1/"),
    ("publisher", SERVED, "/gateway/attic"),
    ("type", SERVED, T),
]


@pytest.fixture
def graph() -> Graph:
    registry = Registry()
    return Graph(registry, Imports(registry))


def test_without_gateways_nothing_is_served(graph: Graph) -> None:
    graph.registry.register_subscriber(ALIAS, T, HERE)
    graph.registry.register_publisher("/pose", T, HERE)
    assert graph.served.gateways() == {}
    assert graph.served.uris(ALIAS) == []
    assert graph.served.topic_type(ALIAS) == "*"


def test_what_a_gateway_publishes_is_served_as_the_alias(graph: Graph) -> None:
    graph.registry.register_publisher(SERVED, T, GATEWAY)
    graph.registry.register_publisher("/gateway/state", T, GATEWAY)  # no name of an origin
    assert graph.served.gateways() == {ALIAS: ("/gateway",)}
    assert graph.served.uris(ALIAS) == [GATEWAY.uri]
    assert graph.served.topic_type(ALIAS) == graph.topic_type(ALIAS) == T
    assert (ALIAS, T) in list(graph.topic_types())
    for other in ("/pose", SERVED, "/remote/clinic/pose", "/remote", "/remote/hospital"):
        assert graph.served.uris(other) == []
        assert graph.served.topic_type(other) == "*"
    graph.registry.remove(Kind.PUBLISHER, SERVED, "/gateway")
    assert graph.served.gateways() == {}


def test_a_gateway_of_another_master_of_the_domain_serves_too(graph: Graph) -> None:
    graph.imports.apply(KITCHEN, ELSEWHERE, [])
    assert graph.served.gateways() == {ALIAS: ("/remote/kitchen/gateway/attic",)}
    assert graph.served.uris(ALIAS) == ["http://10.0.0.3:1/"]
    assert graph.served.topic_type(ALIAS) == T
    graph.registry.register_publisher(SERVED, T, GATEWAY)
    assert graph.served.uris(ALIAS) == [GATEWAY.uri]
    assert graph.served.gateways() == {ALIAS: ("/gateway",)}
    graph.registry.set_silent(GATEWAY, silent=True)
    assert graph.served.uris(ALIAS) == ["http://10.0.0.3:1/"]


def test_from_two_gateways_elsewhere_nobody_gets_everything_twice(graph: Graph) -> None:
    cellar = [("node", "/gateway", "http://10.0.0.4:1/"), ("publisher", SERVED, "/gateway")]
    graph.imports.apply(KITCHEN, ELSEWHERE, [])
    graph.imports.apply(Site("cellar"), cellar, [])
    assert graph.served.uris(ALIAS) == ["http://10.0.0.4:1/"]
    assert graph.served.gateways() == {ALIAS: ("/remote/cellar/gateway",)}
    graph.imports.drop("cellar")
    assert graph.served.uris(ALIAS) == ["http://10.0.0.3:1/"]


def test_a_publisher_elsewhere_that_is_no_gateway_serves_nothing(graph: Graph) -> None:
    facts = [("node", "/robot", "http://10.0.0.4:1/"), ("publisher", SERVED, "/robot")]
    graph.imports.apply(KITCHEN, facts, [])
    assert graph.served.gateways() == {}
    assert graph.served.uris(ALIAS) == []


def test_what_another_domain_serves_at_home_is_a_name_of_it(graph: Graph) -> None:
    graph.imports.apply(HOSPITAL, ELSEWHERE, [])
    assert graph.served.gateways() == {}
    assert graph.imports.publisher_uris(f"/remote/hospital{SERVED}") == ["http://10.0.0.3:1/"]


def test_a_silent_gateway_serves_nothing_until_it_answers(graph: Graph) -> None:
    graph.registry.register_publisher(SERVED, T, GATEWAY)
    assert graph.served.gateways()
    assert graph.registry.set_silent(GATEWAY, silent=True)
    assert graph.served.gateways() == {}
    assert graph.served.uris(ALIAS) == []
    assert graph.registry.set_silent(GATEWAY, silent=False)
    assert graph.served.uris(ALIAS) == [GATEWAY.uri]


def test_what_is_not_taken_from_a_domain_is_not_served(graph: Graph) -> None:
    graph.registry.register_publisher(SERVED, T, GATEWAY)
    assert graph.served.gateways()
    graph.imports.filter.rules = lambda _: Reach([Permission("/map", Right.SUBSCRIBE)])
    graph.imports.taken_anew()
    assert graph.served.gateways() == {}
    assert graph.served.uris(ALIAS) == []


def test_of_an_alias_its_origin_decides_the_type(graph: Graph) -> None:
    graph.registry.register_subscriber(ALIAS, OTHER, HERE)
    assert graph.topic_type(ALIAS) == OTHER  # nobody else says anything
    graph.registry.register_publisher(SERVED, T, GATEWAY)
    assert graph.topic_type(ALIAS) == T
    facts = [
        ("node", "/robot", "http://10.0.0.2:1/"),
        ("publisher", "/pose", "/robot"),
        ("type", "/pose", "pkg/Pose"),
    ]
    assert graph.imports.apply(HOSPITAL, facts, []) != []
    assert graph.topic_type(ALIAS) == "pkg/Pose"
    assert graph.imports.publisher_uris(ALIAS) == ["http://10.0.0.2:1/"]
