"""deny > allow > prompt > default; restrictions accumulate; order does not matter; explanations."""

import dataclasses
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.errors import NameRefused, PatternRefused
from ca.names import pattern_covers
from grants.errors import GrantError, PolicyRefused
from grants.model import ALL_RIGHTS, Right
from grants.policy.decision import Decider, restriction_lines, span
from grants.policy.model import Effect, Policy, Subject
from tests.grants.policy.policies import HEADER, HEATING, decide, node, policy, rules
from tests.grants.policy.test_index import name, pattern, policies, right, subject

TYPES = HEADER + "types: {/pose: geometry_msgs/PoseStamped, /b: std_msgs/String}\n"
X = node("/x")


def effect(of: Policy, name: str, right: Right = Right.SUBSCRIBE, who: Subject = X) -> str:
    return str(decide(of, who, right, name).effect)


def test_a_denial_outweighs_everything() -> None:
    of = rules(
        "{id: a, who: /x, allow: {subscribe: /b}}",
        '{id: d, who: "*", deny: {subscribe: "/**"}}',
        "{id: p, who: /x, prompt: {subscribe: /b}}",
    )
    assert effect(of, "/b") == "deny"


def test_allow_outweighs_prompt_and_prompt_the_default() -> None:
    of = rules("{id: a, who: /x, allow: {subscribe: /b}}", '{id: p, who: /x, prompt: {subscribe: ["/*"]}}')
    assert [effect(of, "/b"), effect(of, "/c"), effect(of, "/c/d")] == ["allow", "prompt", "deny"]


def test_only_allow_is_true() -> None:
    of = rules("{id: a, who: /x, allow: {subscribe: /b}}", "{id: p, who: /x, prompt: {subscribe: /c}}")
    assert [bool(decide(of, X, Right.SUBSCRIBE, topic)) for topic in ("/b", "/c", "/d")] == [
        True,
        False,
        False,
    ]


def test_restrictions_of_all_matching_rules_apply() -> None:
    of = rules(
        "{id: wide, who: /x, allow: {subscribe: [/pose]}, lifetime: 7d, renew_until: 30d}",
        "{id: rough, who: /x, allow: {subscribe: [/pose]}, filter: {pose.position: {round: 1}}, "
        "limit: {rate: 5}, lifetime: 1d, renew_until: never}",
        "{id: day, who: /x, allow: {subscribe: [/pose]}, when: now.getHours() >= 6, limit: {rate: 2}}",
        head=TYPES,
    )
    verdict = decide(of, X, Right.SUBSCRIBE, "/pose")
    assert [rule.id for rule in verdict.rules] == ["day", "rough", "wide"]
    assert sorted(restriction_lines(verdict)) == [
        "at most 2 messages a second",
        "only when now.getHours() >= 6",
        "pose.position: round step 1",
        "valid 1d",
    ]


@given(policies, subject, right, name | pattern, st.randoms(use_true_random=False))
def test_the_order_of_the_rules_does_not_matter(
    of: Policy, asking: Subject, asked: Right, about: str, shuffle: Any
) -> None:
    made = list(of.rules)
    shuffle.shuffle(made)
    one, other = (decide(p, asking, asked, about) for p in (of, dataclasses.replace(of, rules=tuple(made))))
    assert (one.effect, one.restrictions, one.lifetime) == (other.effect, other.restrictions, other.lifetime)


@given(policies, subject, right, name, st.sampled_from(["/c", "/**"]))
def test_nothing_is_allowed_that_no_allowing_rule_names(
    of: Policy, asking: Subject, asked: Right, about: str, other: str
) -> None:
    without = dataclasses.replace(
        of, rules=tuple(rule for rule in of.rules if rule.effect is not Effect.ALLOW)
    )
    assert not decide(without, asking, asked, about)
    assert not decide(without, asking, asked, other)


@given(policies, subject, right, pattern, name)
def test_a_right_on_a_pattern_is_a_right_on_each_of_its_names(
    of: Policy, asking: Subject, asked: Right, about: str, inside: str
) -> None:
    if pattern_covers(about, inside) and decide(of, asking, asked, about):
        assert decide(of, asking, asked, inside)


def test_a_pattern_is_allowed_whole_or_not_at_all() -> None:
    of = rules(
        '{id: a, who: /x, allow: {subscribe: ["/s/**"]}}',
        "{id: r, who: /x, allow: {subscribe: [/s/pose]}, filter: {pose.position: {round: 1}}}",
        "{id: d, who: /x, deny: {subscribe: [/t/secret]}}",
        '{id: t, who: /x, allow: {subscribe: ["/t/**"]}}',
        head=HEADER + "types: {/s/pose: geometry_msgs/PoseStamped}\n",
    )
    whole = decide(of, X, Right.SUBSCRIBE, "/s/**")
    assert whole
    assert len(whole.restrictions) == 1  # a restriction of a part restricts all of it
    assert effect(of, "/**") == "deny"
    assert effect(of, "/t/**") == "deny"
    assert effect(of, "/t/other") == "allow"
    near = "; ".join(Decider(of).near_misses(decide(of, X, Right.SUBSCRIBE, "/u/*")))
    assert (
        near == "rule a is for /s/**, not /u/*; rule r is for /s/pose, not /u/*; "
        "rule t is for /t/**, not /u/*"
    )


# --- faults of earlier systems (F1 to F5) ---


def test_f1_unknown_is_not_allowed() -> None:
    of = policy()
    assert effect(of, "/never/heard/of") == "prompt"  # its default, never allowed
    assert effect(rules(), "/never/heard/of") == "deny"
    for both in (Right.SUBSCRIBE | Right.PUBLISH, Right(0)):
        with pytest.raises(PolicyRefused, match="is not one right"):
            decide(of, X, both, "/a")
    for bad in ("relative", "~private", "/a/", "", "/ä"):
        with pytest.raises(PatternRefused):
            decide(of, X, Right.SUBSCRIBE, bad)
        with pytest.raises(NameRefused):
            decide(of, node(bad), Right.SUBSCRIBE, "/a")


def test_f2_two_nodes_of_one_host_are_distinct_and_so_are_two_keys_of_one_name() -> None:
    of = policy()
    assert effect(of, "/robot/pose", who=HEATING) == "allow"
    assert effect(of, "/robot/pose", who=node("/heating")) == "prompt"
    assert effect(of, "/robot/pose", who=node("/nav/a")) == "allow"
    assert effect(of, "/robot/pose", who=node("/navy/a")) == "prompt"


@pytest.mark.parametrize("flip", [False, True])
def test_f3_a_parent_never_bypasses_a_rule_for_its_child(flip: bool) -> None:
    lines = [
        '{id: wide, who: /x, allow: {param-set: ["/a"], param-get: ["/**"]}}',
        "{id: narrow, who: /x, deny: {param-set: [/a/b]}}",
    ]
    of = rules(*(reversed(lines) if flip else lines))
    answers = [
        effect(of, key, Right.PARAM_SET) for key in ("/a", "/a/b", "/a/b/c", "/a/c", "/") if key != "/"
    ]
    assert answers == ["deny", "deny", "deny", "allow"]
    assert effect(of, "/**", Right.PARAM_SET) == "deny"


def test_f4_no_right_implies_another() -> None:
    of = rules("{id: s, who: /x, allow: {param-set: [/a]}}")
    assert [effect(of, "/a", right) for right in ALL_RIGHTS] == [
        "allow" if right is Right.PARAM_SET else "deny" for right in ALL_RIGHTS
    ]


def test_f5_a_name_is_not_a_prefix_and_a_narrow_denial_overrides() -> None:
    of = rules(
        '{id: a, who: /x, allow: {subscribe: [/chatter, "/s/**"]}}',
        "{id: d, who: /x, deny: {subscribe: [/s/secret]}}",
    )
    assert effect(of, "/chatter") == "allow"
    assert effect(of, "/chatterX") == effect(of, "/chatter/x") == effect(of, "/s") == "deny"
    assert (effect(of, "/s/open"), effect(of, "/s/secret")) == ("allow", "deny")
    assert effect(of, "/chatter", who=node("/xy")) == "deny"


# --- explanations ---


def explained(who: Subject, right: Right, topic: str) -> list[str]:
    decider = Decider(policy())
    return decider.explain(decider.decide(who, right, topic))


def test_an_allowing_verdict_is_explained() -> None:
    assert explained(HEATING, Right.SUBSCRIBE, "/robot/pose") == [
        "ALLOW: /heating subscribe /robot/pose",
        "  rule heating-room: Heating lowers rooms. (allow subscribe /robot/pose)",
        '    only when now.getHours("Europe/Zurich") >= 6 && msg.header.frame_id == "map"',
        "    pose.orientation: clear",
        "    pose.position: round step 2.0",
        "    at most 0.2 messages a second",
        "    valid 7d, renewed until 180d",
        "  without heating-room it would be prompt, by default",
    ]


def test_a_denial_names_its_rule() -> None:
    assert explained(HEATING, Right.SUBSCRIBE, "/camera/image") == [
        "DENY: /heating subscribe /camera/image",
        "  rule no-camera: no (deny subscribe /camera/**)",
        "  without no-camera it would be prompt, by default",
    ]


@pytest.mark.parametrize(
    ("who", "right", "topic", "miss"),
    [
        (node("/toaster"), Right.SUBSCRIBE, "/robot/pose", "rule heating-room is for heating, not /toaster"),
        (
            node("/heating"),
            Right.SUBSCRIBE,
            "/robot/pose",
            "rule heating-room is for another key of heating, not /heating",
        ),
        (HEATING, Right.PUBLISH, "/robot/pose", "rule heating-room gives subscribe, not publish"),
        (HEATING, Right.PUBLISH, "/heatings/x", "rule heating-own is for /heating/**, not"),
        (node("/nav/a"), Right.PUBLISH, "/*", "rule nav-full covers /cmd_vel, which is not all of"),
    ],
)
def test_near_misses(who: Subject, right: Right, topic: str, miss: str) -> None:
    lines = explained(who, right, topic)
    assert any(line.startswith(f"  near miss: {miss}") for line in lines), lines
    assert "  no rule matches, so the default decides" in lines
    asked = f"{right.label}: [{topic}]"
    assert lines[-1] == f"  an allow rule for {who.name} with {asked} would change it"


def test_changes_name_the_next_deciding_rule() -> None:
    of = rules("{id: d, who: /x, deny: {call: /b}}", "{id: a, who: /x, allow: {call: /b}}")
    decider = Decider(of)
    verdict = decider.decide(X, Right.CALL, "/b")
    assert decider.changes(verdict) == ["without d it would be allow, by a"]


@given(policies, subject, right, name | pattern)
def test_every_verdict_has_an_explanation(of: Policy, asking: Subject, asked: Right, about: str) -> None:
    decider = Decider(of)
    lines = decider.explain(decider.decide(asking, asked, about))
    assert len(lines) >= 2


def test_spans_in_the_largest_unit() -> None:
    assert [span(n) for n in (0, 90, 120, 7200, 86400, 90000)] == ["0s", "90s", "2m", "2h", "1d", "25h"]


def test_policy_errors_are_grant_errors() -> None:
    assert issubclass(PolicyRefused, GrantError)


def test_a_pattern_takes_the_rate_and_the_validity_of_its_parts() -> None:
    policy = rules(
        '{id: a, who: /x, allow: {subscribe: ["/r/**"]}, on_stale: keep, lifetime: 7d}',
        "{id: b, who: /x, allow: {subscribe: [/r/pose]}, limit: {rate: 2}, lifetime: 1h}",
        "{id: c, who: /x, allow: {subscribe: [/other]}, limit: {rate: 1}, lifetime: 1m}",
    )
    verdict = decide(policy, node("/x"), Right.SUBSCRIBE, "/r/**")
    assert verdict
    assert (verdict.rate, verdict.lifetime, verdict.keep_when_stale) == (2, 3600, False)
    assert [rule.id for rule in verdict.rules] == ["a", "b"]
    decider = Decider(policy)
    for name_ in ("/r/**", "/r/pose", "/r/odom"):
        asked = (node("/x"), Right.SUBSCRIBE, name_)
        by = decider.decide_by(decider.rules_of(node("/x")), *asked)
        assert by == decider.decide(*asked)


OWN = rules('{id: own, why: "Its own.", who: "*", allow: {publish: ["{node}/pose"]}}')


def test_own_names_are_explained_as_written_and_as_they_are() -> None:
    found = Decider(OWN)
    lines = found.explain(found.decide(node("/robot1"), Right.PUBLISH, "/robot1/pose"))
    assert lines[1] == "  rule own: Its own. (allow publish {node}/pose, here /robot1/pose)"
    other = found.explain(found.decide(node("/robot2"), Right.PUBLISH, "/robot1/pose"))
    assert "rule own is for {node}/pose, here /robot2/pose, not /robot1/pose" in other[2]


def test_a_name_may_be_asked_as_a_rule_has_it() -> None:
    found = Decider(OWN).decide(node("/robot1"), Right.PUBLISH, "{node}/pose")
    assert (bool(found), found.name) == (True, "/robot1/pose")
    alias = Decider(OWN).decide(node("/remote/lab/robot1"), Right.PUBLISH, "{node}/pose")
    assert (alias.effect, alias.rules) == (Effect.DENY, ())
    with pytest.raises(PatternRefused):
        Decider(OWN).decide(node("/robot1"), Right.PUBLISH, "{node}/../pose")


def test_a_tail_pattern_is_decided_for_its_tail_alone() -> None:
    found = Decider(OWN)
    rviz = Subject("/rviz", bytes(32), tail=True)
    assert found.decide(rviz, Right.PUBLISH, "/rviz~/pose")
    assert found.decide(rviz, Right.PUBLISH, "/rviz_1/pose")
    for other in (node("/rviz"), node("/rviz_1"), Subject("/rvi", bytes(32), tail=True)):
        assert not found.decide(other, Right.PUBLISH, "/rviz~/pose")
    assert not found.decide(rviz, Right.PUBLISH, "/rviz_1~/pose")


@pytest.mark.parametrize("decision", ["deny", "prompt"])
def test_who_approves_a_pattern_does_not_undo_what_a_rule_restricts_in_it(decision: str) -> None:
    """A node presents the grants it chooses: one for all of /r/** would show the pose exactly."""
    head = f"""rossec: 1
robot: r
defaults: {{decision: {decision}, lifetime: 2d}}
types: {{/r/pose: geometry_msgs/PoseStamped}}
"""
    policy = rules(
        '{id: all, who: /asks, prompt: {subscribe: ["/r/**"]}}',
        "{id: pose, who: '*', allow: {subscribe: [/r/pose]}, see: {position: room}, lifetime: 1d}",
        "{id: odom, who: '*', allow: {subscribe: [/r/odom]}, lifetime: 1h}",
        head=head,
    )
    exact = decide(policy, node("/asks"), Right.SUBSCRIBE, "/r/pose")
    asked = decide(policy, node("/asks"), Right.SUBSCRIBE, "/r/**")
    assert (asked.effect, asked.restrictions, asked.rate) == (Effect.PROMPT, exact.restrictions, exact.rate)
    assert [rule.id for rule in asked.rules] == ["all", "pose"]
    by_default = decide(policy, node("/other"), Right.SUBSCRIBE, "/r/**")
    assert (by_default.effect, by_default.rules) == (Effect(decision), ())
    if decision == "prompt":
        assert by_default.restrictions == exact.restrictions
        assert (by_default.rate, by_default.lifetime) == (exact.rate, 86400)
    else:
        assert (by_default.restrictions, by_default.rate) == ((), None)


@pytest.mark.parametrize("right", [Right.PARAM_GET, Right.PARAM_SET])
def test_a_parameter_is_given_no_longer_than_what_is_below_it(right: Right) -> None:
    """A grant on /a is one on /a/b: it would outlive what was said of /a/b."""
    head = HEADER + "defaults: {lifetime: 30d}\n"
    policy = rules(
        f"{{id: all, who: /n, allow: {{{right.label}: [/a]}}}}",
        f"{{id: part, who: /n, allow: {{{right.label}: [/a/b]}}, lifetime: 1h}}",
        head=head,
    )
    for key in ("/a", "/a/b", "/a/b/c"):
        found = decide(policy, node("/n"), right, key)
        assert (found.effect, found.lifetime) == (Effect.ALLOW, 3600), key
    assert decide(policy, node("/n"), right, "/a/c").lifetime == 30 * 86400
    part = rules(f"{{id: part, who: /n, allow: {{{right.label}: [/a/b]}}}}", head=head)
    assert decide(part, node("/n"), right, "/a").effect is Effect.DENY
