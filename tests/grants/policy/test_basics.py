"""`basics` of a policy."""

import pytest

from grants.model import Right
from grants.policy.decision import Decider
from grants.policy.lint import lint
from grants.policy.model import DAY, Subject
from grants.policy.rules import ID, is_basics
from grants.policy.wanted import WantedState
from grants.request import BASICS, TRANSFORMS
from rossec.authority.policyfile import layout_of
from tests.grants.policy.policies import HEADER, mistakes, node, policy, rules

TRUE = f"{HEADER}basics: true\n"
WIDE = "{id: own, who: /tool, allow: {param-get: /**}, lifetime: 30d, renew_until: 90d, why: all}"


def wanted(text_rules: tuple[str, ...], subject: Subject, head: str = TRUE) -> set[tuple[Right, str]]:
    state = WantedState(Decider(rules(*text_rules, head=head)))
    return {each.atom for each in state.of(subject).rights}


def test_every_node_gets_the_table_and_no_more() -> None:
    expected = {
        (right, name.replace("{node}", "/talker")) for right, names in BASICS.items() for name in names
    }
    assert wanted((), node("/talker")) == expected
    assert wanted((), node("/talker"), HEADER) == set()


def test_an_anonymous_node_gets_the_services_of_each_of_its_runs() -> None:
    found = wanted((), Subject("/rviz", bytes(32), tail=True))
    assert (Right.PROVIDE, "/rviz~/get_loggers") in found


def test_a_node_of_another_domain_gets_nothing() -> None:
    assert wanted((), node("/remote/hospital/rounds/robot3")) == set()


def test_the_transforms_are_given_only_if_said() -> None:
    plain = wanted((), node("/talker"))
    more = wanted((), node("/talker"), f"{HEADER}basics: [tf]\n")
    assert more - plain == {(Right.SUBSCRIBE, name) for name in TRANSFORMS}
    assert plain <= more


def test_nobody_speaks_for_another_by_basics() -> None:
    decider = Decider(rules(head=TRUE))
    assert decider.decide(node("/a"), Right.PROVIDE, "/a/get_loggers")
    assert not decider.decide(node("/a"), Right.PROVIDE, "/b/get_loggers")
    assert not decider.decide(node("/a"), Right.SUBSCRIBE, "/rosout")
    assert not decider.decide(node("/a"), Right.PUBLISH, "/clock")
    assert not decider.decide(node("/a"), Right.PARAM_SET, "/use_sim_time")


def test_a_denial_overrides_basics() -> None:
    found = wanted(("{id: no, who: /eve, deny: {publish: /rosout}}",), node("/eve"))
    assert (Right.PUBLISH, "/rosout") not in found
    assert (Right.PARAM_GET, "/use_sim_time") in found


def test_basics_do_not_shorten_a_wide_rule() -> None:
    state = WantedState(Decider(rules(WIDE, head=TRUE)))
    [wide] = [each for each in state.of(node("/tool")).rights if each.pattern == "/**"]
    assert (wide.lifetime, wide.renew_until) == (30 * DAY, 90 * DAY)


def test_explain_names_basics() -> None:
    decider = Decider(rules(head=TRUE))
    lines = decider.explain(decider.decide(node("/a"), Right.PUBLISH, "/rosout"))
    assert "  rule basics: what every ROS program needs (allow publish /rosout)" in lines


def test_lint_remarks_nothing_on_basics() -> None:
    assert lint(rules(head=TRUE), layout_of) == []


def test_the_rule_is_recognized() -> None:
    [rule] = rules(head=TRUE).rules
    assert is_basics(rule)
    assert rule.line == 3
    [other] = rules("{id: basics, who: /a, allow: {call: /s}}").rules
    assert not is_basics(other)
    assert other.id == ID


@pytest.mark.parametrize("said", ["false"])
def test_without_basics_there_is_no_rule(said: str) -> None:
    assert policy(f"{HEADER}basics: {said}\nrules: []\n").rules == ()


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ("yes", "basics is true, false or a list"),
        ("tf", "basics is true, false or a list"),
        ("[]", "basics is true, false or a list"),
        ("{tf: true}", "unknown part of basics"),
        ("[odom]", "unknown part of basics: 'odom'"),
    ],
)
def test_other_basics_are_mistakes(said: str, message: str) -> None:
    [mistake] = mistakes(f"{HEADER}basics: {said}\nrules: []\n")
    assert mistake.message.startswith(message)
    assert mistake.hint


def test_no_other_rule_may_be_called_so() -> None:
    [mistake] = mistakes(f"{TRUE}rules: [{{id: basics, who: /a, allow: {{call: /s}}}}]\n")
    assert "basics" in mistake.message
