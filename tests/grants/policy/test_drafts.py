"""From verdicts to drafts, and through a real signature to the decision on a grant."""

from dataclasses import replace

import pytest

from grants.decision import authorize
from grants.document import open_grant, sign
from grants.errors import PolicyRefused
from grants.model import Draft, FilterRule, Restriction, Right
from grants.policy.decision import Decider, Verdict
from grants.policy.model import DAY, HOUR, Effect, Policy, Subject
from grants.policy.wanted import approve, approximate, drafts, limit, permissions, plan, shorten
from grants.request import RequestedRight
from tests.grants.authority import CA, NOW
from tests.grants.policy.policies import HEADER, decide, node, rules

X = node("/x")
ROUND = (FilterRule("pose.position", "round", (("step", 2.0),)),)


@pytest.fixture
def policy() -> Policy:
    return rules(
        "{id: a, who: /x, allow: {subscribe: [/pose, /b], publish: [/c]}, renew_until: 30d}",
        "{id: r, who: /x, allow: {subscribe: [/pose]}, filter: {pose.orientation: {clear: true}}}",
        "{id: s, who: /x, allow: {subscribe: [/pose]}, when: now.getHours() >= 6}",
        "{id: p, who: /x, prompt: {call: [/lift]}, lifetime: 2h}",
        "{id: d, who: /x, deny: {call: [/door]}, why: stays shut}",
        head=HEADER + "types: {/pose: geometry_msgs/PoseStamped}\n",
    )


def verdict_on(policy: Policy, right: Right, name: str) -> Verdict:
    return decide(policy, X, right, name)


def made(*verdicts: Verdict) -> list[Draft]:
    return drafts(verdicts, domain="home", now=NOW, serial=lambda: bytes(16))


def test_requested_rights_are_sorted_by_decision(policy: Policy) -> None:
    rights = [
        RequestedRight(Right.CALL, "/door"),
        RequestedRight(Right.CALL, "/lift"),
        RequestedRight(Right.SUBSCRIBE, "/b"),
        RequestedRight(Right.SUBSCRIBE, "/b"),
        RequestedRight(Right.SUBSCRIBE, "/unheard"),
    ]
    sorted_ = plan(Decider(policy), X, rights)
    assert [v.name for v in sorted_.allowed] == ["/b"]
    assert [v.name for v in sorted_.prompted] == ["/lift"]
    assert [v.name for v in sorted_.denied] == ["/unheard", "/door"]
    assert str(rights[0]) == "call /door"


def test_a_signed_draft_has_the_decided_restrictions(policy: Policy) -> None:
    pose = verdict_on(policy, Right.SUBSCRIBE, "/pose")
    (draft,) = made(pose)
    grant = open_grant(sign(CA, draft), CA.public_key, NOW)
    found = authorize([grant], Right.SUBSCRIBE, "/pose", holder=X.key, now=NOW, check=lambda *_: None)
    assert found.restrictions == pose.restrictions
    assert len(found.restrictions) == 2
    assert (found.expires, grant.cap) == (NOW + 7 * DAY, NOW + 7 * DAY)


def test_one_draft_for_each_validity(policy: Policy) -> None:
    long = [verdict_on(policy, Right.SUBSCRIBE, "/b"), verdict_on(policy, Right.PUBLISH, "/c")]
    short = approve(verdict_on(policy, Right.CALL, "/lift"))
    first, second = made(*long, short)
    assert [item.pattern for item in first.permissions] == ["/b", "/c"]
    assert (first.expires, first.cap) == (NOW + 7 * DAY, NOW + 30 * DAY)
    assert (second.expires, second.cap) == (NOW + 2 * HOUR, NOW + 2 * HOUR)
    assert (second.subject, second.holder, second.domain) == ("/x", X.key, "home")


def test_only_allowed_verdicts_are_signed(policy: Policy) -> None:
    with pytest.raises(PolicyRefused, match="not allowed: PROMPT: /x call /lift"):
        made(verdict_on(policy, Right.CALL, "/lift"))


def test_a_denial_cannot_be_approved(policy: Policy) -> None:
    with pytest.raises(PolicyRefused, match="the policy denies call /door: rule d: stays shut"):
        approve(verdict_on(policy, Right.CALL, "/door"))
    with pytest.raises(PolicyRefused, match="no rule allows it"):
        approve(verdict_on(policy, Right.CALL, "/unheard"))


def test_approximate_adds_to_what_the_policy_restricts(policy: Policy) -> None:
    coarse = Restriction("geometry_msgs/PoseStamped", (), ROUND, rate=0.5)
    rough = approximate(verdict_on(policy, Right.SUBSCRIBE, "/pose"), coarse)
    assert replace(coarse, rate=None) in rough.restrictions
    assert (len(permissions(rough)), rough.rate) == (3, 0.5)
    with pytest.raises(PolicyRefused, match="cannot be approximate"):
        approximate(verdict_on(policy, Right.PUBLISH, "/c"), coarse)


def test_shortening_never_extends_the_lifetime(policy: Policy) -> None:
    verdict = verdict_on(policy, Right.SUBSCRIBE, "/b")
    assert (shorten(verdict, HOUR).lifetime, shorten(verdict, HOUR).renew_until) == (HOUR, 0)
    assert shorten(verdict, 99 * DAY).lifetime == 7 * DAY


def test_a_limit_ends_the_renewals_too_and_never_extends(policy: Policy) -> None:
    verdict = replace(verdict_on(policy, Right.SUBSCRIBE, "/b"), lifetime=HOUR, renew_until=7 * DAY)
    assert (limit(verdict, DAY).lifetime, limit(verdict, DAY).renew_until) == (HOUR, DAY)
    assert (limit(verdict, 60).lifetime, limit(verdict, 60).renew_until) == (60, 60)
    assert limit(verdict, 99 * DAY) == verdict


def test_the_lowest_rate_is_in_every_restriction(policy: Policy) -> None:
    verdict = verdict_on(policy, Right.SUBSCRIBE, "/b")
    limited = replace(verdict, clauses=(replace(verdict.clauses[0], rate=2.0),))
    assert [item.restriction for item in permissions(limited)] == [Restriction(rate=2.0)]
    pose = verdict_on(policy, Right.SUBSCRIBE, "/pose")
    limited = replace(pose, clauses=(*pose.clauses, replace(pose.clauses[0], rate=2.0)))
    rates = [item.restriction.rate for item in permissions(limited) if item.restriction]
    assert rates == [2.0, 2.0]


def test_effects_are_exhaustive() -> None:
    assert [str(effect) for effect in Effect] == ["deny", "allow", "prompt"]


def test_on_stale_reaches_the_grant_when_every_rule_says_keep() -> None:
    policy = rules(
        "{id: a, who: /x, allow: {subscribe: [/stop, /pose]}, on_stale: keep}",
        "{id: b, who: /x, allow: {subscribe: [/pose]}, when: now.getHours() >= 6, on_stale: cut}",
        "{id: c, who: /x, allow: {subscribe: [/slow]}, limit: {rate: 1}, on_stale: keep}",
    )
    kept, slow, cut = (verdict_on(policy, Right.SUBSCRIBE, name) for name in ("/stop", "/slow", "/pose"))
    assert [item.restriction for item in permissions(kept)] == [Restriction(keep_when_stale=True)]
    [limited] = permissions(slow)
    assert limited.restriction == Restriction(rate=1, keep_when_stale=True)
    assert "kept while revocation data is stale" in "".join(Decider(policy).explain(kept))
    assert not cut.keep_when_stale
    assert not verdict_on(policy, Right.CALL, "/none").keep_when_stale


def test_a_draft_is_backdated_by_the_skew(policy: Policy) -> None:
    verdict = verdict_on(policy, Right.SUBSCRIBE, "/b")
    (draft,) = drafts([verdict], domain="home", now=NOW, serial=lambda: bytes(16), skew=60)
    assert (draft.not_before, draft.expires) == (NOW - 60, NOW + 7 * DAY)


def test_tail_patterns_have_a_draft_of_their_own() -> None:
    policy = rules('{id: a, who: "*", allow: {provide: [~/get_loggers], publish: [/map]}}')
    rviz = Subject("/rviz", bytes(32), tail=True)
    asked = [RequestedRight(Right.PROVIDE, "/rviz~/get_loggers"), RequestedRight(Right.PUBLISH, "/map")]
    allowed = plan(Decider(policy), rviz, asked).allowed
    made = drafts(allowed, domain="home", now=0, serial=lambda: bytes(16))
    assert sorted(each.permissions[0].pattern for each in made) == ["/map", "/rviz~/get_loggers"]
    assert [len(each.permissions) for each in made] == [1, 1]
