"""A plan: which nodes get what, which grants go, and how long the list becomes. Nothing changes."""

from dataclasses import replace
from pathlib import Path

import pytest

from ca.revocation.lists import MAX_ENTRIES
from grants import document
from grants.model import Draft, Grant, Permission, Right
from grants.policy.difference import Moment
from rossec.authority import policyfile as module
from rossec.authority.policyfile import PlanOptions, PolicyFile, PolicyPlan, make_plan
from rossec.authority.signing import SKEW
from rossec.home import NodeHome
from tests.support.site import DAY, Site

NOW = 1_800_000_000
POLICY = """rossec: 1
robot: r
rules:
  - {id: a, who: "*", allow: {subscribe: [/pose], publish: [/odom]}, lifetime: 1d}
  - {id: d, who: "*", deny: {call: [/lift]}}
"""


@pytest.fixture
def site(tmp_path: Path) -> Site:
    made = Site(tmp_path / "site", clock=lambda: NOW)
    for name in ("/robot", "/viewer", "/master"):
        made.enroll(name, 30 * DAY)
    return made


def policy(site: Site, text: str = POLICY) -> PolicyFile:
    path = site.root / "policy.yaml"
    path.write_text(text)
    return PolicyFile.read(path)


def plan(site: Site, text: str = POLICY, options: PlanOptions | None = None, later: int = 0) -> PolicyPlan:
    moment = Moment(NOW + later, SKEW)
    return make_plan(site.authority.store, policy(site, text), options or PlanOptions(), moment)


def sign(site: Site, made: PolicyPlan, now: int = NOW) -> list[Grant]:
    drafts = list(made.drafts("home", now, lambda: bytes(16)))
    return [document.peek(data) for data in site.authority.issue_grants(drafts, now)]


def by_hand(site: Site, name: str, *permissions: Permission, expires: int = NOW + DAY) -> Grant:
    draft = Draft(
        "home",
        name,
        site.identity(name).thumbprint,
        NOW - SKEW,
        expires,
        NOW + 2 * DAY,
        name.encode().ljust(16),
        permissions,
    )
    return document.peek(site.authority.issue_grant(draft, NOW))


def test_every_node_but_the_trusted_ones_gets_its_rights(site: Site) -> None:
    made = plan(site)
    assert [node.subject.name for node in made.nodes] == ["/robot", "/viewer"]
    assert (made.signs, made.revoke, made.ends) == (2, (), NOW + DAY)
    grants = sign(site, made)
    assert [grant.subject for grant in grants] == ["/robot", "/viewer"]
    assert grants[0].permissions == (Permission("/pose", Right.SUBSCRIBE), Permission("/odom", Right.PUBLISH))
    times = (grants[0].not_before, grants[0].expires, grants[0].cap)
    assert times == (NOW - SKEW, NOW + DAY, NOW + DAY)
    again = plan(site)
    assert again.is_empty
    assert again.entries > made.entries


def test_only_the_nodes_asked_for(site: Site) -> None:
    sign(site, plan(site, options=PlanOptions(("/viewer",))))
    assert plan(site, options=PlanOptions(("/viewer",))).is_empty
    (node,) = plan(site, options=PlanOptions(("/robot", "/nobody"))).nodes
    assert node.subject.name == "/robot"


def test_a_replaced_key_gets_its_own_grants(site: Site) -> None:
    sign(site, plan(site))
    old = site.identity("/robot").thumbprint
    home = NodeHome.of(site.root, "/robot")
    for path in home.path.glob("node.*"):  # it is set up again
        path.unlink()
    home.create_request("home")
    home.install(site.authority.issue(home.request(), NOW, DAY, replace_key="/robot"), NOW)
    made = plan(site)
    new = [each.subject.key for each in made.nodes if each.sign]
    assert new == [site.identity("/robot").thumbprint] != [old]
    assert made.revoke == ()  # they go with the old key


def test_a_node_whose_identity_ended_only_loses(site: Site) -> None:
    sign(site, plan(site, POLICY.replace("1d", "90d")))
    later = 40 * DAY
    assert plan(site, POLICY.replace("1d", "90d"), later=later).is_empty
    made = plan(site, POLICY.replace("1d", "80d"), later=later)
    assert (made.signs, len(made.revoke)) == (0, 2)


def test_grants_by_hand_are_pruned_but_for_the_rest(site: Site) -> None:
    sign(site, plan(site))
    lift, led = Permission("/lift", Right.CALL), Permission("/led", Right.PUBLISH)
    mixed = by_hand(site, "/robot", lift, led)
    bare = by_hand(site, "/viewer", lift)
    made = plan(site)
    assert [each.grant for each in made.contradictions] == [mixed, bare]
    assert made.is_empty
    pruned = plan(site, options=PlanOptions(prune=True))
    assert pruned.contradictions == ()
    assert (set(pruned.revoke), pruned.signs, pruned.listed) == ({mixed, bare}, 1, 2)
    ((draft, rules),) = pruned.drafts("home", NOW, lambda: bytes(16))
    assert (draft.permissions, draft.expires, draft.cap, rules) == ((led,), mixed.expires, mixed.cap, "")
    assert list(pruned.drafts("home", mixed.expires, lambda: bytes(16))) == []


def test_the_list_is_measured_before_anything_is_signed(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    sign(site, plan(site))
    less = POLICY.replace(", publish: [/odom]", "")
    made = plan(site, less)
    assert (made.signs, made.listed, made.needs_tree) == (2, 2, False)
    assert replace(made, listed=MAX_ENTRIES + 1).needs_tree
    monkeypatch.setattr(module, "MAX_LEAVES", 1)
    full = plan(site, less)
    assert (full.signs, full.listed, len(full.revoke)) == (0, 1, 0) or full.listed == 1
    assert all("room for 1 revocations" in reason for reason in full.refused)
    assert full.refused


def test_what_is_due_is_renewed_when_asked(site: Site) -> None:
    sign(site, plan(site))
    made = plan(site, later=DAY * 3 // 4)
    assert made.is_empty
    assert [len(node.due) for node in made.nodes] == [1, 1]
    moment = Moment(NOW + DAY * 3 // 4, SKEW, renew_due=True)
    made = make_plan(site.authority.store, policy(site), PlanOptions(), moment)
    assert (made.signs, made.revoke) == (2, ())


def test_plans_that_do_the_same_have_the_same_effect(site: Site) -> None:
    made = plan(site)
    effect = made.effect("home")
    assert len(effect) == 32
    assert plan(site, later=100).effect("home") == effect, "whenever it is made"
    assert made.effect("other") != effect
    sign(site, made)
    assert plan(site).effect("home") != effect
    goes = plan(site, POLICY.replace("/pose", "/scan"))
    assert goes.effect("home") != replace(goes, nodes=goes.nodes[:1]).effect("home")


def test_a_gateway_gets_its_rights_by_hand_and_keeps_them(site: Site) -> None:
    """It is reserved, as a master is: a rule for everybody is not about what it may receive."""
    for name in ("/gateway", "/gateway/attic"):
        site.enroll(name, 30 * DAY)
    serves = by_hand(site, "/gateway", Permission("/gateway/hospital/**", Right.PUBLISH))
    made = plan(site, POLICY, PlanOptions(prune=True))
    assert [node.subject.name for node in made.nodes if node.sign] == ["/robot", "/viewer"]
    assert serves.id not in [grant.id for grant in made.revoke]


def test_served_names_are_granted_like_any_other(site: Site) -> None:
    text = POLICY.replace("subscribe: [/pose]", "subscribe: [/gateway/hospital/**]")
    assert sign(site, plan(site, text))[0].permissions[0] == Permission(
        "/gateway/hospital/**", Right.SUBSCRIBE
    )
