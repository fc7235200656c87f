"""What another master is shown: own registrations only, what it may see, what it wants."""

from dataclasses import replace
from typing import Any

import pytest

from grants.decision import Reach
from grants.model import Permission, Right
from rossec.master.api.graph_calls import is_unchanged
from rossec.master.api.site_calls import FOLLOW, MAX_PATTERNS
from rossec.master.rights.caller import Caller
from rossec.master.state.imported_facts import Site
from rossec.master.state.imports import Imports
from rossec.master.state.registry import NodeRef, Registry
from tests.rossec.master.fakes import FakeStatements, call_api, caller, master_api, refuse

T = "std_msgs/String"
LASER, ARM = NodeRef("/laser", "http://l:1/", b"laser"), NodeRef("/arm", "http://a:1/", b"arm")
SCAN = [["node", "/laser", "http://l:1/"], ["publisher", "/scan", "/laser"], ["type", "/scan", T]]
RESET = [
    ["node", "/arm", "http://a:1/"],
    ["provider", "/reset", "rosrpc://a:2"],
    ["service", "/reset", "/arm"],
]


class Followed:
    """A master with a scanner and an arm."""

    def __init__(self) -> None:
        self.registry = Registry()
        self.imports = Imports(self.registry)
        self.statements = FakeStatements()
        self.api = master_api(
            self.registry,
            self.statements,
            name="/master",
            uri="http://m:1/",
            pid=7,
            instance="first",
            imports=self.imports,
        )
        self.registry.register_publisher("/scan", T, LASER)
        self.registry.register_service("/reset", "rosrpc://a:2", ARM)

    def call(self, who: Caller, *params: object) -> Any:
        return call_api(self.api, FOLLOW, [_at_home(who), *params], who, 0).answer

    def facts(self, who: Caller, *wanted: str) -> list[list[str]]:
        answer = self.call(who, "", 0, [*wanted])
        assert answer[0] == 1, answer
        found: list[list[str]] = answer[2]["added"]
        return found


def _at_home(who: Caller) -> str:
    return who.name.removeprefix("/remote/hospital")


@pytest.fixture
def followed() -> Followed:
    return Followed()


def master() -> Caller:
    return Caller("/master/kitchen", b"kitchen", Reach(()), refuse, is_own_master=True)


def foreign_master(exported: dict[str, Right] | None, graph: str = "/**") -> Caller:
    reach = Reach([Permission(graph, Right.GRAPH), Permission("/master", Right.GRAPH)])
    rules = None if exported is None else Reach(Permission(*each) for each in exported.items())
    return Caller("/remote/hospital/master", b"hospital", reach, refuse, exported=rules)


def test_a_master_of_the_own_domain_is_shown_everything_without_a_grant(followed: Followed) -> None:
    assert followed.facts(master()) == sorted(SCAN + RESET)


def test_another_node_needs_graph_on_the_master_and_on_each_name(followed: Followed) -> None:
    code, status, _ = followed.call(caller("/tool", {"/scan": Right.GRAPH}), "", 0, [])
    assert code == -1
    assert "needs the right graph on /master" in status
    rights = {"/master": Right.GRAPH, "/scan": Right.GRAPH, "/reset": Right.CALL}
    assert followed.facts(caller("/tool", rights)) == SCAN


def test_a_foreigner_is_shown_what_is_exported_to_its_domain(followed: Followed) -> None:
    exported = foreign_master({"/scan": Right.SUBSCRIBE})
    assert followed.facts(exported) == SCAN
    assert followed.facts(foreign_master(None)) == sorted(SCAN + RESET)
    assert followed.facts(foreign_master({"/scan": Right.SUBSCRIBE}, graph="/reset")) == []


def test_what_is_imported_is_never_shown(followed: Followed) -> None:
    facts = [("node", "/n", "http://10.0.0.2:1/"), ("publisher", "/far", "/n")]
    followed.imports.apply(Site("attic"), facts, [])
    followed.imports.apply(Site("hospital", "hospital"), facts, [])
    assert followed.facts(master()) == sorted(SCAN + RESET)


def test_names_of_another_origin_are_not_shown(followed: Followed) -> None:
    guest = NodeRef("/remote/hospital/rounds", "http://g:1/", b"guest")
    followed.registry.register_publisher("/cmd", T, guest)
    followed.registry.register_subscriber("/remote/hospital/pose", T, LASER)
    assert followed.facts(master()) == sorted(SCAN + RESET)


@pytest.mark.parametrize(
    ("wanted", "shown"),
    [
        (["/scan"], SCAN),
        (["/reset", "/other"], RESET),
        (["/**"], sorted(SCAN + RESET)),
        (["/arm"], RESET[:1]),
        ([""], []),
        (["/sc"], []),
        (["/*"], sorted(SCAN + RESET)),
    ],
)
def test_what_is_wanted_is_sent(followed: Followed, wanted: list[str], shown: list[list[str]]) -> None:
    assert followed.facts(master(), *wanted) == shown


def test_wanting_more_or_less_is_a_change_of_the_view(followed: Followed) -> None:
    first = followed.call(master(), "", 0, ["/scan"])[2]
    more = followed.call(master(), "first", first["cursor"], [])[2]
    assert (more["added"], more["removed"], more["whole"]) == (RESET, [], False)
    less = followed.call(master(), "first", more["cursor"], [""])[2]
    assert (less["added"], less["removed"]) == ([], sorted(SCAN + RESET))


@pytest.mark.parametrize("wanted", ["/scan", [5], ["scan"], ["/a//b"], ["/**x"], ["/a"] * 4097, [b"/scan"]])
def test_malformed_wants_are_refused(followed: Followed, wanted: object) -> None:
    code, status, default = followed.call(master(), "", 0, wanted)
    assert (code, default) == (-1, {})
    assert "wanted" in status


def test_patterns_that_cost_with_each_name_are_bounded(followed: Followed) -> None:
    wanted = [f"/*/x{number}" for number in range(MAX_PATTERNS + 1)]
    code, status, _ = followed.call(master(), "", 0, wanted)
    assert code == -1
    assert "want everything, with an empty list" in status
    assert followed.facts(master(), *wanted[1:]) == []


def test_an_answer_has_the_digests_of_the_lists(followed: Followed) -> None:
    followed.statements.lists.append(b"list 1")
    answer = followed.call(master(), "", 0, [])[2]
    assert (answer["revocations"], answer["domains"]) == (b"list 1", b"domains")
    foreign = followed.call(foreign_master(None), "", 0, [])[2]
    assert (foreign["revocations"], foreign["domains"]) == (b"list 1", b"")


def test_a_list_that_changed_between_two_calls_is_a_change(followed: Followed) -> None:
    first = followed.call(master(), "", 0, [])
    assert not is_unchanged(first, 0)
    again = followed.call(master(), "first", first[2]["cursor"], [])
    assert is_unchanged(again, first[2]["cursor"])
    followed.statements.lists.append(b"list 1")
    changed = followed.call(master(), "first", first[2]["cursor"], [])
    assert not is_unchanged(changed, first[2]["cursor"])
    assert changed[2]["added"] == []


def test_views_of_disconnected_keys_are_discarded(followed: Followed) -> None:
    first = followed.call(master(), "", 0, [])
    followed.api.keep_views(frozenset({b"kitchen"}))
    assert not followed.call(master(), "first", first[2]["cursor"], [])[2]["whole"]
    followed.api.keep_views(frozenset())
    assert followed.call(master(), "first", first[2]["cursor"], [])[2]["whole"]


def test_what_a_silent_gateway_serves_is_not_told_to_other_masters(followed: Followed) -> None:
    served, gateway = "/gateway/hospital/pose", NodeRef("/gateway", "http://g:1/", b"gateway")
    other = replace(caller("/master/kitchen", {"/master": Right.GRAPH}), is_own_master=True)
    followed.registry.register_publisher(served, T, gateway)
    assert ["publisher", served, "/gateway"] in followed.facts(other, served)
    followed.registry.set_silent(gateway, silent=True)
    assert followed.facts(other, served) == []
    assert ["node", "/gateway", "http://g:1/"] in followed.facts(other)
    followed.registry.set_silent(gateway, silent=False)
    assert ["publisher", served, "/gateway"] in followed.facts(other, served)
