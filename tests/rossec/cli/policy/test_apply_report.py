"""The difference as text and as JSON: what is the same for many nodes is one line."""

from dataclasses import replace
from pathlib import Path

import pytest

from grants.policy.difference import ChangeKind, Moment
from rossec.authority.policyfile import PlanOptions, PolicyFile, PolicyPlan, make_plan
from rossec.authority.signing import SKEW
from rossec.cli.policy import check
from tests.support.site import DAY, Site

NOW = 1_800_000_000
POLICY = """rossec: 1
robot: r
rules:
  - {id: a, who: "*", allow: {subscribe: [/pose]}}
  - {id: b, who: /n1, allow: {publish: ["/**"]}, lifetime: 1d}
  - {id: d, who: "*", deny: {publish: [/secret]}, why: no}
"""


@pytest.fixture
def site(tmp_path: Path) -> Site:
    made = Site(tmp_path / "site", clock=lambda: NOW)
    for number in range(1, 6):
        made.enroll(f"/n{number}", 30 * DAY)
    return made


def plan(site: Site, text: str, later: int = 0) -> PolicyPlan:
    path = site.root / "policy.yaml"
    path.write_text(text)
    moment = Moment(NOW + later, SKEW)
    return make_plan(site.authority.store, PolicyFile.read(path), PlanOptions(), moment)


def sign(site: Site, made: PolicyPlan) -> None:
    site.authority.issue_grants(list(made.drafts("home", NOW, lambda: bytes(16))), NOW)


def test_what_is_the_same_for_many_nodes_is_one_line(site: Site) -> None:
    made = plan(site, POLICY)
    assert list(check.lines(made)) == [
        "+ /n1, /n2, /n3 and 2 more nodes: subscribe /pose, valid 7d (rule a, line 4)",
        (
            "! /n1: publish /** (rule b, line 5) is not granted: rule d, line 6 denies some of it;"
            " write the rule for narrower names"
        ),
        "the first grant of the policy ends 2027-01-22 08:00:00 UTC",
    ]
    assert check.summary(made) == "sign 5 grants"


def test_what_is_left_is_counted_and_what_goes_is_named(site: Site) -> None:
    sign(site, plan(site, POLICY))
    assert next(check.lines(plan(site, POLICY))) == "= 5 rights of 5 nodes as before"
    denied = POLICY.replace("publish: [/secret]", "subscribe: [/pose]")
    made = plan(site, denied)
    gone = "- /n1, /n2, /n3 and 2 more nodes: subscribe /pose (rule d, line 6)"
    assert gone in check.lines(made)
    assert check.summary(made) == "sign 1 grant and revoke 5 grants"


def test_a_tree_and_due_grants_are_announced(site: Site) -> None:
    sign(site, plan(site, POLICY))
    lines = list(check.lines(replace(plan(site, POLICY, 5 * DAY), listed=5000)))
    assert "the revocations are a tree of 5000 entries: a list has at most 4096" in lines
    assert "5 grants due for renewal: rossec policy apply --renew" in lines
    assert "the policy is in force, nothing to do" in lines


def test_programs_get_each_right_of_each_node(site: Site) -> None:
    shown = check.as_json(plan(site, POLICY))
    assert isinstance(shown["changes"], list)
    assert [row["node"] for row in shown["changes"]] == [f"/n{n}" for n in range(1, 6)]
    assert shown["changes"][0]["kind"] == ChangeKind.NEW
    assert shown["withheld"] == [
        {
            "node": "/n1",
            "right": "publish",
            "name": "/**",
            "effect": "deny",
            "rule": {"id": "b", "line": 5, "why": ""},
            "by": {"id": "d", "line": 6, "why": "no"},
        }
    ]


def test_one_and_many() -> None:
    assert [check.count(n, "node") for n in (0, 1, 2)] == ["0 nodes", "1 node", "2 nodes"]
