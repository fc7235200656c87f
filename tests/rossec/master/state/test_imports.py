"""What other masters have registered: merged, hidden, withdrawn; never more than was sent."""

import pytest

from grants.decision import Reach
from grants.model import Permission, Right
from rossec.errors import ImportRefused
from rossec.master.state.imported_facts import Site, TypeContradicted
from rossec.master.state.imports import Imports
from rossec.master.state.registry import Kind, NodeRef, PublishersChanged, Registry

T, OTHER = "std_msgs/String", "std_msgs/Int32"
KITCHEN, ATTIC = Site("kitchen"), Site("attic")
HOSPITAL, WARD = Site("hospital", "hospital"), Site("ward", "hospital")
HERE = NodeRef("/here", "http://10.0.0.1:1/", b"here")
ROBOT = ("node", "/robot", "http://10.0.0.2:1/")
POSE = [ROBOT, ("publisher", "/pose", "/robot"), ("type", "/pose", T)]
RESET = [ROBOT, ("service", "/reset", "/robot"), ("provider", "/reset", "rosrpc://10.0.0.2:9")]

Fact = tuple[str, str, str]


@pytest.fixture
def registry() -> Registry:
    return Registry()


@pytest.fixture
def imports(registry: Registry) -> Imports:
    return Imports(registry)


def subscribe(registry: Registry, topic: str, type_name: str = "*") -> None:
    registry.register_subscriber(topic, type_name, HERE)


def changed(topic: str, *uris: str) -> PublishersChanged:
    return PublishersChanged(topic, (HERE,), uris)


def test_topics_of_the_own_domain_keep_their_names(imports: Imports) -> None:
    imports.apply(KITCHEN, POSE, [])
    assert imports.nodes_of(Kind.PUBLISHER, "/pose") == ("/remote/kitchen/robot",)
    assert imports.publisher_uris("/pose") == [ROBOT[2]]
    assert imports.topic_type("/pose") == T
    assert list(imports.nodes()) == [("/remote/kitchen/robot", ROBOT[2])]
    assert imports.node_uri("/remote/kitchen/robot") == ROBOT[2]
    assert imports.node_uri("/robot") is None
    assert imports.keys_of("/remote/kitchen/robot", Kind.PUBLISHER) == ("/pose",)


def test_everything_of_a_foreign_domain_lies_below_its_label(imports: Imports) -> None:
    imports.apply(HOSPITAL, [*POSE, *RESET], [])
    assert imports.nodes_of(Kind.PUBLISHER, "/remote/hospital/pose") == ("/remote/hospital/robot",)
    assert imports.nodes_of(Kind.PUBLISHER, "/pose") == ()
    assert imports.service_uri("/remote/hospital/reset") == "rosrpc://10.0.0.2:9"
    assert imports.service_uri("/reset") is None


def test_local_subscribers_are_told_of_imported_publishers(registry: Registry, imports: Imports) -> None:
    subscribe(registry, "/pose")
    registry.register_publisher("/pose", T, NodeRef("/own", "http://10.0.0.1:2/", b"own"))
    own, there = "http://10.0.0.1:2/", ROBOT[2]
    assert imports.apply(KITCHEN, POSE, []) == [changed("/pose", own, there)]
    assert imports.apply(KITCHEN, POSE, []) == []  # nothing new
    _, events = registry.unregister(Kind.PUBLISHER, "/pose", NodeRef("/own", "http://10.0.0.1:2/", b"own"))
    assert events == [changed("/pose", there)]
    moved = ("node", "/robot", "http://10.0.0.3:1/")
    assert imports.apply(KITCHEN, [moved], [ROBOT]) == [changed("/pose", moved[2])]
    assert imports.drop("kitchen") == [changed("/pose")]


def test_subscribers_of_an_alias_are_told_by_its_alias(registry: Registry, imports: Imports) -> None:
    subscribe(registry, "/remote/hospital/pose")
    assert imports.apply(HOSPITAL, POSE, []) == [changed("/remote/hospital/pose", ROBOT[2])]


def test_a_whole_answer_replaces_what_was_held(registry: Registry, imports: Imports) -> None:
    subscribe(registry, "/pose")
    imports.apply(KITCHEN, [*POSE, *RESET], [])
    assert imports.apply(KITCHEN, RESET, [], whole=True) == [changed("/pose")]
    assert imports.service_uri("/reset") is not None
    assert [(each.site, each.facts) for each in imports.sites] == [(KITCHEN, 3)]


def test_what_is_registered_here_wins(registry: Registry, imports: Imports) -> None:
    imports.apply(KITCHEN, RESET, [])
    registry.register_service("/reset", "rosrpc://10.0.0.1:9", HERE)
    assert imports.service_uri("/reset") is None
    assert imports.nodes_of(Kind.SERVICE, "/reset") == ()
    registry.unregister_service("/reset", "/here", "rosrpc://10.0.0.1:9", b"here")
    assert imports.service_uri("/reset") == "rosrpc://10.0.0.2:9"  # it was only hidden


def test_of_two_sites_the_lower_label_provides_a_service(imports: Imports) -> None:
    for site, host in ((KITCHEN, 3), (ATTIC, 4)):
        facts = [
            ("node", "/n", f"http://10.0.0.{host}:1/"),
            ("service", "/reset", "/n"),
            ("provider", "/reset", f"rosrpc://10.0.0.{host}:9"),
        ]
        imports.apply(site, facts, [])
    assert imports.nodes_of(Kind.SERVICE, "/reset") == ("/remote/attic/n",)
    assert imports.service_uri("/reset") == "rosrpc://10.0.0.4:9"
    imports.drop("attic")
    assert imports.service_uri("/reset") == "rosrpc://10.0.0.3:9"


def test_a_topic_with_another_type_is_not_imported_and_reported_once(
    registry: Registry, imports: Imports
) -> None:
    subscribe(registry, "/pose", OTHER)
    found = imports.apply(KITCHEN, POSE, [])
    assert found == [TypeContradicted("kitchen", "/pose", OTHER, T)]
    assert imports.publisher_uris("/pose") == []
    assert imports.apply(KITCHEN, [], POSE) == []
    assert imports.apply(KITCHEN, POSE, []) == []  # reported before
    assert registry.topic_type("/pose") == OTHER


def test_a_type_that_is_learnt_here_ends_what_contradicts_it(registry: Registry, imports: Imports) -> None:
    imports.apply(KITCHEN, POSE, [])
    subscribe(registry, "/pose")
    other = NodeRef("/second", "http://10.0.0.1:3/", b"second")
    events = registry.register_subscriber("/pose", OTHER, other)
    assert events == [PublishersChanged("/pose", (HERE, other), ())]


def test_sites_that_contradict_each_other_leave_the_type_of_the_lower_label(imports: Imports) -> None:
    imports.apply(KITCHEN, POSE, [])
    facts = [("node", "/n", "http://10.0.0.9:1/"), ("publisher", "/pose", "/n"), ("type", "/pose", OTHER)]
    imports.apply(ATTIC, facts, [])
    assert imports.topic_type("/pose") == OTHER
    assert imports.nodes_of(Kind.PUBLISHER, "/pose") == ("/remote/attic/n",)


def test_two_sites_of_one_foreign_domain_share_their_names(imports: Imports) -> None:
    imports.apply(HOSPITAL, POSE, [])
    imports.apply(WARD, [ROBOT, ("publisher", "/map", "/robot")], [])
    assert list(imports.nodes()) == [("/remote/hospital/robot", ROBOT[2])]
    assert imports.nodes_of(Kind.PUBLISHER, "/remote/hospital/map") == ("/remote/hospital/robot",)


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "[::1]", "169.254.0.9", "[fe80::1]"])
def test_an_address_that_means_another_machine_here_is_not_imported(imports: Imports, host: str) -> None:
    facts = [("node", "/robot", f"http://{host}:1/"), ("publisher", "/pose", "/robot")]
    imports.apply(KITCHEN, facts, [])
    assert imports.publisher_uris("/pose") == []
    assert list(imports.nodes()) == []


def test_a_site_that_is_followed_over_loopback_is_on_this_host(imports: Imports) -> None:
    facts = [("node", "/robot", "http://127.0.0.1:1/"), ("publisher", "/pose", "/robot")]
    imports.apply(Site("kitchen", on_this_host=True), facts, [])
    assert imports.publisher_uris("/pose") == ["http://127.0.0.1:1/"]


def test_an_address_that_is_registered_here_is_not_imported(registry: Registry, imports: Imports) -> None:
    subscribe(registry, "/pose")
    registry.register_service("/own", "rosrpc://10.0.0.1:9", HERE)
    facts: list[Fact] = [
        ("node", "/robot", "http://10.0.0.1:1/"),
        ("publisher", "/pose", "/robot"),
        ("node", "/arm", "http://10.0.0.2:1/"),
        ("service", "/reset", "/arm"),
        ("provider", "/reset", "rosrpc://10.0.0.1:9"),
    ]
    assert imports.apply(KITCHEN, facts, []) == []
    assert imports.publisher_uris("/pose") == []
    assert imports.service_uri("/reset") is None


def test_a_node_of_the_own_domain_that_is_registered_here_is_not_imported(
    registry: Registry, imports: Imports
) -> None:
    registry.register_publisher("/pose", T, NodeRef("/robot", "http://10.0.0.1:7/", b"robot"))
    imports.apply(KITCHEN, POSE, [])
    assert imports.publisher_uris("/pose") == []
    imports.apply(HOSPITAL, POSE, [])
    assert imports.publisher_uris("/remote/hospital/pose") == [ROBOT[2]]


@pytest.mark.parametrize(
    "fact",
    [
        ("publisher", "/remote/x/pose", "/robot"),
        ("publisher", "/pose", "/remote/x/robot"),
        ("publisher", "pose", "/robot"),
        ("friend", "/pose", "/robot"),
        ("node", "/robot", "rosrpc://10.0.0.2:1"),
        ("node", "/robot", "http://10.0.0.2/"),
        ("node", "/robot", f"http://10.0.0.2:1/{'x' * 600}"),
        ("type", "/pose", "*"),
        ("type", "/pose", "a/b/c"),
        ("provider", "/reset", "http://10.0.0.2:1/"),
    ],
)
def test_a_malformed_fact_refuses_the_whole_answer(imports: Imports, fact: Fact) -> None:
    imports.apply(KITCHEN, POSE, [])
    with pytest.raises(ImportRefused):
        imports.apply(KITCHEN, [*RESET, fact], [])
    assert imports.service_uri("/reset") is None
    assert imports.publisher_uris("/pose") == [ROBOT[2]]


def test_a_site_has_a_bounded_number_of_facts(registry: Registry) -> None:
    imports = Imports(registry, limit=3)
    imports.apply(KITCHEN, POSE, [])
    with pytest.raises(ImportRefused, match="more than 3"):
        imports.apply(KITCHEN, [("subscriber", "/map", "/robot")], [])
    replaced = [ROBOT, ("subscriber", "/map", "/robot")]
    imports.apply(KITCHEN, replaced, [], whole=True)
    assert [each.facts for each in imports.sites] == [2]


def test_a_lost_site_keeps_its_facts_until_it_is_dropped(imports: Imports) -> None:
    imports.apply(KITCHEN, POSE, [])
    imports.lose("kitchen")
    imports.lose("nobody")
    assert [each.is_lost for each in imports.sites] == [True]
    assert imports.publisher_uris("/pose") == [ROBOT[2]]
    imports.apply(KITCHEN, [], [])
    assert [each.is_lost for each in imports.sites] == [False]
    imports.drop("kitchen")
    assert imports.drop("kitchen") == []
    assert (imports.sites, list(imports.keys(Kind.PUBLISHER))) == ((), [])


def test_subscribers_do_not_leave_the_publishers_of_a_site_that_is_lost_for_long(
    registry: Registry, imports: Imports
) -> None:
    """Also when another publisher comes; when the site is back they learn what has changed."""
    subscribe(registry, "/pose")
    imports.apply(KITCHEN, POSE, [])
    imports.lose("kitchen")
    imports.expire("kitchen")
    assert imports.nodes_of(Kind.PUBLISHER, "/pose") == ()
    assert list(imports.nodes()) == []
    assert imports.publisher_uris("/pose") == [ROBOT[2]]
    other = ("node", "/robot", "http://10.0.0.9:9/")
    assert imports.apply(ATTIC, [other, *POSE[1:]], []) == [changed("/pose", other[2], ROBOT[2])]
    assert imports.apply(KITCHEN, POSE, [], whole=True) == []
    imports.expire("kitchen")
    assert imports.apply(KITCHEN, [], [], whole=True) == [changed("/pose", other[2])]


def test_what_was_kept_of_a_site_goes_when_it_is_dropped(registry: Registry, imports: Imports) -> None:
    subscribe(registry, "/pose")
    imports.apply(KITCHEN, POSE, [])
    imports.expire("kitchen")
    imports.expire("kitchen")
    assert imports.drop("kitchen") == [changed("/pose")]
    assert imports.drop("kitchen") == []
    imports.apply(KITCHEN, POSE, [])
    imports.expire("kitchen")
    registry.register_service("/s", "rosrpc://10.0.0.2:1", NodeRef("/r", ROBOT[2], b"r"))
    assert imports.publisher_uris("/pose") == [], "it is an address of a node here now"


def test_another_site_under_a_label_replaces_the_one_before(imports: Imports) -> None:
    imports.apply(KITCHEN, POSE, [])
    imports.apply(Site("kitchen", "hospital"), RESET, [])
    assert imports.publisher_uris("/pose") == []
    assert imports.service_uri("/remote/hospital/reset") == "rosrpc://10.0.0.2:9"


def test_a_name_that_is_too_long_for_an_alias_is_left_out(imports: Imports) -> None:
    long = "/" + "n" * 250
    facts = [ROBOT, ("publisher", long, "/robot"), ("type", long, T), ("publisher", "/a", long)]
    imports.apply(HOSPITAL, [*facts, ("node", long, "http://10.0.0.5:1/")], [])
    assert list(imports.keys(Kind.PUBLISHER)) == ["/remote/hospital/a"]
    assert imports.nodes_of(Kind.PUBLISHER, "/remote/hospital/a") == ()
    assert [name for name, _ in imports.nodes()] == ["/remote/hospital/robot"]
    imports.apply(HOSPITAL, [], facts)


def test_the_version_grows_with_each_change_only(imports: Imports) -> None:
    imports.apply(KITCHEN, POSE, [])
    before = imports.version
    imports.apply(KITCHEN, POSE, [])
    assert imports.version == before
    imports.apply(KITCHEN, [], POSE[:1])
    assert imports.version > before


def test_sites_are_settled_when_they_have_answered_what_is_wanted(imports: Imports) -> None:
    settled = [imports.is_settled]
    imports.apply(KITCHEN, [], [])
    settled.append(imports.is_settled)
    imports.settle("kitchen", imports.demand.version)
    imports.settle("nobody", 7)
    settled.append(imports.is_settled)
    imports.demand.ask("/map", 0)
    settled.append(imports.is_settled)
    imports.lose("kitchen")
    settled.append(imports.is_settled)
    assert settled == [True, False, True, False, True]
    assert imports.demand.wanted(KITCHEN, 0) == ("/map",)


def test_of_a_foreign_domain_only_what_the_rules_take_in_counts(imports: Imports) -> None:
    rules = {"hospital": Reach((Permission("/pose", Right.SUBSCRIBE),))}
    imports.filter.rules = rules.get
    imports.apply(HOSPITAL, [*POSE, *RESET, ("node", "/nurse", "http://10.0.0.4:1/")], [])
    assert imports.publisher_uris("/remote/hospital/pose") == [ROBOT[2]]
    assert imports.topic_type("/remote/hospital/pose") == T
    assert imports.service_uri("/remote/hospital/reset") is None
    assert imports.nodes_of(Kind.SERVICE, "/remote/hospital/reset") == ()
    assert list(imports.nodes()) == [("/remote/hospital/robot", ROBOT[2])]
    assert imports.node_uri("/remote/hospital/nurse") is None
    rules["hospital"] = Reach((Permission("/reset", Right.CALL),))
    assert imports.publisher_uris("/remote/hospital/pose") == []
    assert imports.service_uri("/remote/hospital/reset") == "rosrpc://10.0.0.2:9"


def test_what_may_only_be_seen_has_no_address(imports: Imports) -> None:
    rules = {"hospital": Reach((Permission("/**", Right.GRAPH),))}
    imports.filter.rules = rules.get
    imports.apply(HOSPITAL, [*POSE, *RESET], [])
    pose, reset = "/remote/hospital/pose", "/remote/hospital/reset"
    assert imports.nodes_of(Kind.PUBLISHER, pose) == ("/remote/hospital/robot",)
    assert imports.nodes_of(Kind.SERVICE, reset) == ("/remote/hospital/robot",)
    assert imports.publisher_uris(pose) == []
    assert imports.service_uri(reset) is None


def test_other_rules_are_told_to_subscribers_and_hide_the_own_domain_never(
    registry: Registry, imports: Imports
) -> None:
    alias, rules = "/remote/hospital/pose", {"kitchen": Reach(()), "hospital": Reach(())}
    imports.filter.rules = rules.get
    subscribe(registry, alias)
    imports.apply(HOSPITAL, POSE, [])
    imports.apply(KITCHEN, POSE, [])
    assert imports.publisher_uris("/pose") == [ROBOT[2]]
    before, rules["hospital"] = imports.version, Reach((Permission("/pose", Right.SUBSCRIBE),))
    assert imports.taken_anew() == [changed(alias, ROBOT[2])]
    assert imports.version > before
