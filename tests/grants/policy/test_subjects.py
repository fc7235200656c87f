"""Groups of nodes stand for their members, and for nothing else."""

import pytest

from grants.model import Right
from grants.policy.model import Subject
from grants.policy.rules import MAX_MEMBERS
from tests.grants.policy.policies import HEADER, HEATING, HEATING_KEY, decide, mistakes, node, rules

HEAD = f"""{HEADER}identities:
  heating: {{node: /heating, key: "sha256:{HEATING_KEY.hex()}"}}
groups:
  robots: [/robot1, "/fleet/*"]
  home: [robots, heating, "hospital:/rounds/*"]
  spare: /spare
"""
ALLOW = "{id: a, who: home, except: /fleet/old, allow: {subscribe: /map}}"


@pytest.mark.parametrize(
    ("subject", "expected"),
    [
        (node("/robot1"), True),
        (node("/fleet/a"), True),
        (node("/fleet/old"), False),
        (HEATING, True),
        (node("/heating"), False),
        (node("/robot11"), False),
        (node("/robots"), False),
        (node("/home"), False),
        (node("/fleet/a/b"), False),
        (node("/remote/hospital/rounds/x"), True),
        (node("/spare"), False),
    ],
)
def test_a_rule_for_a_group_is_one_for_its_members(subject: Subject, expected: bool) -> None:
    policy = rules(ALLOW, head=HEAD)
    assert bool(decide(policy, subject, Right.SUBSCRIBE, "/map")) is expected


def test_an_exception_for_a_group_is_one_for_its_members() -> None:
    policy = rules('{id: a, who: "*", except: robots, allow: {subscribe: /map}}', head=HEAD)
    assert not decide(policy, node("/fleet/a"), Right.SUBSCRIBE, "/map")
    assert decide(policy, node("/other"), Right.SUBSCRIBE, "/map")


def test_a_denial_for_a_group_denies_a_member_by_its_key_too() -> None:
    policy = rules(
        "{id: a, who: [home, spare], deny: {subscribe: /map}}",
        '{id: b, who: "*", allow: {subscribe: /map}}',
        head=HEAD,
    )
    for denied in (node("/heating"), node("/renamed", HEATING_KEY), node("/spare")):
        assert not decide(policy, denied, Right.SUBSCRIBE, "/map")
    assert decide(policy, node("/other"), Right.SUBSCRIBE, "/map")


def test_it_is_shown_by_its_name() -> None:
    (rule,) = rules(ALLOW, head=HEAD).rules
    assert rule.subjects_text == "home except /fleet/old"
    assert {who.label for who in rule.who} == {"/robot1", "/fleet/*", "heating", "hospital:/rounds/*"}


def test_groups_of_a_policy_and_those_without_a_rule() -> None:
    policy = rules(ALLOW, head=HEAD)
    assert [who.label for who in policy.groups["robots"]] == ["/robot1", "/fleet/*"]
    assert policy.unused_groups == ("spare",)
    assert rules("{id: a, who: robots, allow: {call: /a}}", head=HEAD).unused_groups == ("home", "spare")


def test_the_order_of_groups_does_not_matter() -> None:
    turned = HEADER + "groups: {b: [a, /x], a: [/y]}\n"
    policy = rules("{id: r, who: b, allow: {call: /c}}", head=turned)
    assert [who.node for who in policy.rules[0].who] == ["/y", "/x"]
    assert policy.unused_groups == ()


def test_a_node_without_its_slash_is_told_how_it_is_written() -> None:
    [mistake] = mistakes(HEADER + "rules:\n  - {id: r, who: heating, allow: {call: /c}}\n")
    assert mistake.message == "unknown identity 'heating'"
    assert mistake.hint == "a node is written /heating"


@pytest.mark.parametrize(
    ("groups", "message", "hint"),
    [
        ("{a: [b], b: [a]}", "group a is a member of itself: a, b, a", "in one of them"),
        ("{a: [a]}", "group a is a member of itself: a, a", "in one of them"),
        ("{a: [robt], robots: /x}", "unknown identity 'robt'", "'robots'"),
        ("{a: []}", "group a has no members", "add a name"),
        ("{a: ['*']}", "group a: * is every node", "who: '*'"),
        ("{heating: [/x]}", "'heating' is an identity already", "another name"),
        ("{node: [/x]}", "'node' cannot be the name of a group", "not node"),
        ("{/a: [/x]}", "'/a' cannot be the name", "begin with a letter"),
        ("{'a:b': [/x]}", "'a:b' cannot be the name", "begin with a letter"),
        ("{a: ['{node}']}", "'{node}' is no node", "names of a rule"),
        ("{a: ['~/x']}", "'~/x' is no node", "names of a rule"),
        ("{a: [/robot*]}", "'/robot*'", "whole"),
        ("{a: [{x: 1}]}", "a member of group a must be text", "quotes"),
        ("[a]", "groups must be a mapping", "key: value"),
        ("{a: /remote/x/y}", "with the label of the domain", "hospital:/rounds/*"),
    ],
)
def test_mistakes_in_groups(groups: str, message: str, hint: str) -> None:
    head = HEADER + "identities: {heating: {node: /heating}}\n"
    found = mistakes(f"{head}groups: {groups}\nrules: []\n")
    assert len(found) == 1, found
    assert message in found[0].message
    assert hint in found[0].hint
    assert found[0].line == 4


def test_too_many_members_are_refused() -> None:
    listed = ", ".join(f"/n{at}" for at in range(MAX_MEMBERS + 1))
    (found,) = mistakes(f"{HEADER}groups:\n  a: [{listed}]\nrules: []\n")
    assert "more than 1000 members" in found.message
    repeated = ", ".join(["/n"] * (MAX_MEMBERS + 1))
    assert not mistakes(f"{HEADER}groups:\n  a: [{repeated}]\nrules: []\n")


@pytest.mark.parametrize("who", ["'{node}'", "~/x", "'{robots}'"])
def test_own_names_are_not_who_a_rule_is_for(who: str) -> None:
    (found,) = mistakes(f"{HEAD}rules: [{{id: a, who: {who}, allow: {{call: /a}}}}]\n")
    assert "is no node" in found.message
