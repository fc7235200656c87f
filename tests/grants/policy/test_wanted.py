"""What a policy gives outright: what it allows whole, each right once, and why not the rest."""

import pytest

from grants.model import Permission, Restriction, Right
from grants.policy.decision import Decider
from grants.policy.model import DAY, Effect, Policy, Subject
from grants.policy.wanted import WantedRight, WantedState, rule_ids
from tests.grants.policy.policies import HEADER, node, rules

X, Y = node("/x"), node("/y")
TYPES = HEADER + "types: {/pose: geometry_msgs/PoseStamped}\n"


def state(policy: Policy) -> WantedState:
    return WantedState(Decider(policy))


def named(found: tuple[WantedRight, ...]) -> list[str]:
    return [f"{each.right.label} {each.pattern}" for each in found]


def test_each_allowed_clause_is_wanted_once() -> None:
    policy = rules(
        "{id: a, who: /x, allow: {subscribe: [/b, /c], publish: [/b]}, lifetime: 2d}",
        '{id: b, who: "*", allow: {subscribe: [/c]}, renew_until: 30d}',
    )
    wanted = state(policy).of(X)
    assert named(wanted.rights) == ["subscribe /b", "subscribe /c", "publish /b"]
    assert wanted.withheld == ()
    shared = wanted.rights[1]
    assert rule_ids(shared.rules) == "a b"
    assert (shared.lifetime, shared.renew_until) == (2 * DAY, 0)  # the shortest of both
    assert shared.permissions == (Permission("/c", Right.SUBSCRIBE),)
    assert named(state(policy).of(Y).rights) == ["subscribe /c"]


def test_what_a_rule_restricts_is_wanted_restricted() -> None:
    policy = rules(
        "{id: a, who: /x, allow: {subscribe: [/pose]}, limit: {rate: 2}}",
        "{id: b, who: /x, allow: {subscribe: [/pose]}, filter: {pose.orientation: {clear: true}}}",
        head=TYPES,
    )
    (wanted,) = state(policy).of(X).rights
    (entry,) = wanted.permissions
    assert entry.restriction is not None
    assert entry.restriction.lines() == ["pose.orientation: clear", "at most 2 messages a second"]


def test_a_pattern_has_the_restrictions_and_the_validity_of_its_parts() -> None:
    """A peer presents only the grants it chooses: each must give no more than the policy."""
    policy = rules(
        '{id: a, who: /x, allow: {subscribe: ["/r/**"]}, on_stale: keep, lifetime: 7d}',
        "{id: b, who: /x, allow: {subscribe: [/r/pose]}, limit: {rate: 2}, lifetime: 1d}",
    )
    whole, part = state(policy).of(X).rights
    limited = Restriction(rate=2)
    assert whole.permissions == (Permission("/r/**", Right.SUBSCRIBE, limited),)
    assert part.permissions == (Permission("/r/pose", Right.SUBSCRIBE, limited),)
    assert whole.lifetime == part.lifetime == DAY


@pytest.mark.parametrize("denied", ["/r/secret", "/r/**", "/*/secret"])
def test_a_pattern_of_which_a_name_is_denied_is_withheld(denied: str) -> None:
    policy = rules(
        '{id: a, who: /x, allow: {subscribe: ["/r/**", /ok]}}',
        f'{{id: d, who: "*", deny: {{subscribe: ["{denied}"]}}}}',
    )
    wanted = state(policy).of(X)
    assert named(wanted.rights) == ["subscribe /ok"]
    (withheld,) = wanted.withheld
    assert (withheld.pattern, withheld.effect) == ("/r/**", Effect.DENY)
    assert (withheld.rule.id, withheld.by.id) == ("a", "d")
    assert withheld.by.line == withheld.rule.line + 1


def test_what_a_person_decides_is_left_to_a_person() -> None:
    policy = rules(
        "{id: p, who: /x, prompt: {call: [/lift, /door]}}", "{id: a, who: /x, allow: {call: [/door]}}"
    )
    wanted = state(policy).of(X)
    assert named(wanted.rights) == ["call /door"]
    ((right, pattern, effect, rule, by),) = wanted.withheld
    assert (right, pattern, effect) == (Right.CALL, "/lift", Effect.PROMPT)
    assert rule is by is policy.rules[0]


def test_nodes_with_the_same_rules_share_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    of = state(rules('{id: a, who: "/f/**", allow: {call: [/a, /b]}}'))
    first = of.of(node("/f/one"))
    assert len(first.rights) == 2
    monkeypatch.setattr(Decider, "decide_by", None)  # would be called for other rules
    assert of.of(node("/f/two")) is first
    assert of.of(node("/other")).rights == ()


def test_a_verdict_is_for_the_subject_asked() -> None:
    of = state(rules('{id: a, who: "*", allow: {call: [/a]}}'))
    for subject in (X, Y, X):
        verdict = of.decide(subject, (Right.CALL, "/a"))
        assert (verdict.subject, verdict.effect) == (subject, Effect.ALLOW)
    assert of.decide(X, (Right.CALL, "/b")).effect is Effect.DENY


def test_rules_are_named_in_one_order() -> None:
    found = rules("{id: b, who: /x, allow: {call: [/a]}}", "{id: a, who: /x, allow: {call: [/b]}}")
    assert rule_ids((*found.rules, found.rules[0])) == "a b"


def test_what_nobody_renews_is_not_wanted_renewed() -> None:
    policy = rules(
        '{id: a, who: [/x, "hospital:/x"], allow: {subscribe: [/b]}, renew_until: 30d}',
        '{id: b, who: "*", allow: {subscribe: [/c]}}',
    )
    found = state(policy)
    (own, everybody), (foreign,) = found.of(X).rights, found.of(node("/remote/hospital/x")).rights
    assert (own.renew_until, foreign.renew_until) == (30 * DAY, 0)
    assert (own.pattern, everybody.pattern, foreign.pattern) == ("/b", "/c", "/b")
    assert found.of(node("/remote/clinic/x")).rights == ()


OWN = rules(
    '{id: a, who: "*", allow: {provide: [~/get_loggers], publish: ["{node}/pose", /map]}}',
    '{id: b, who: "*", deny: {publish: [/x/pose]}}',
)


def test_each_node_gets_its_own_names() -> None:
    wanted = state(OWN)
    x, y = wanted.of(X), wanted.of(Y)
    assert named(x.rights) == ["provide /x/get_loggers", "publish /map"]
    assert [(each.pattern, each.by.id) for each in x.withheld] == [("/x/pose", "b")]
    assert named(y.rights) == ["provide /y/get_loggers", "publish /y/pose", "publish /map"]
    assert wanted.of(X) == x
    assert wanted.decide(X, (Right.PROVIDE, "/x/get_loggers"))
    assert not wanted.decide(Y, (Right.PROVIDE, "/x/get_loggers"))


def test_a_tail_gets_tail_patterns_and_no_other_node_does() -> None:
    wanted = state(OWN)
    rviz = Subject("/rviz", bytes(32), tail=True)
    found = wanted.of(rviz).rights
    assert named(found) == ["provide /rviz~/get_loggers", "publish /rviz~/pose", "publish /map"]
    assert found[0].permissions == (Permission("/rviz~/get_loggers", Right.PROVIDE),)
    assert wanted.decide(rviz, (Right.PROVIDE, "/rviz~/get_loggers"))
    for other in (node("/rviz"), Subject("/rviz_1", bytes(32), tail=True)):
        assert not wanted.decide(other, (Right.PROVIDE, "/rviz~/get_loggers"))


def test_a_denial_of_one_name_of_the_tail_withholds_all_of_it() -> None:
    policy = rules(
        "{id: a, who: /rviz, allow: {publish: [~/pose]}}",
        '{id: b, who: "*", deny: {publish: [/rviz_left/pose]}}',
    )
    wanted = state(policy).of(Subject("/rviz", bytes(32), tail=True))
    assert wanted.rights == ()
    assert [(each.pattern, each.by.id) for each in wanted.withheld] == [("/rviz~/pose", "b")]
    assert named(state(policy).of(node("/rviz")).rights) == ["publish /rviz/pose"]


def test_no_pattern_of_others_gives_a_tail_pattern_to_a_node_without_a_tail() -> None:
    wide = state(rules('{id: a, who: "*", allow: {publish: ["/**"]}}'))
    atom = (Right.PUBLISH, "/x~/pose")
    assert not wide.decide(X, atom)
    assert wide.decide(Subject("/x", bytes(32), tail=True), atom)


def test_a_foreigner_gets_no_own_names() -> None:
    policy = rules('{id: a, who: "lab:/*", allow: {publish: [~/pose, /map]}}')
    found = state(policy).of(node("/remote/lab/robot")).rights
    assert named(found) == ["publish /map"]
