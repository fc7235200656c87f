"""The beginning of a policy."""

import re

import pytest

from grants.model import Right
from grants.policy.decision import Decider
from grants.policy.learn import NewRule, add_rules, beginning
from grants.policy.lint import lint
from rossec.authority.policyfile import layout_of
from tests.grants.policy.policies import node, policy


def test_it_gives_basics_and_nothing_to_remark() -> None:
    begun = policy(beginning("home"))
    assert [rule.id for rule in begun.rules] == ["basics"]
    assert lint(begun, layout_of) == []
    assert begun.robot == "home"


@pytest.mark.parametrize("robot", ["a: b", '"', "#", "{x}", "é", "yes"])
def test_any_name_can_be_given(robot: str) -> None:
    assert policy(beginning(robot)).robot == robot


def test_rules_can_be_added_and_the_comments_stay() -> None:
    text = beginning("home")
    rule = NewRule("talk", "it talks", "/talker", "allow", {"publish": ["/chatter"]})
    added = add_rules(text, [rule])
    assert Decider(policy(added)).decide(node("/talker"), Right.PUBLISH, "/chatter")
    assert added.count("#") == text.count("#")


def test_its_examples_are_valid() -> None:
    """What stands after `As in` replaces the empty value below it."""
    text = beginning("home")
    for name in ("types", "rules", "tests"):
        found = re.search(rf"^#   {name}:(.*\n(?:#     .*\n)*)", text, re.MULTILINE)
        assert found is not None
        written = found[0].replace("#   ", "", 1).replace("\n#   ", "\n")
        [empty] = re.findall(rf"^{name}: .*$", text, re.MULTILINE)
        text = text.replace(f"\n{empty}", f"\n{written}")
    whole = policy(text)
    assert [rule.id for rule in whole.rules] == ["pose", "heating", "basics"]
