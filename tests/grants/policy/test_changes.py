"""A right before and after: what is certain to be narrower or wider is called so."""

import pytest

from grants.model import FilterRule, Permission, Restriction, Right
from grants.policy.decision import Decider
from grants.policy.difference import Before, Change, ChangeKind, change_of, withdrawn
from grants.policy.model import DAY, Effect, PolicyRule
from grants.policy.wanted import WantedRight
from tests.grants.policy.policies import node, rules

X = node("/x")
RULE = PolicyRule("r", Effect.ALLOW, (), (), line=7)
POSE = "geometry_msgs/PoseStamped"
SLOW, FAST = Restriction(rate=1), Restriction(rate=2)
DAYTIME = Restriction(conditions=("now.getHours() >= 6",))
ROUND = Restriction(POSE, (), (FilterRule("pose.position", "round", (("step", 2.0),)),))
COARSE = Restriction(POSE, (), (FilterRule("pose.position", "round", (("step", 9.0),)),))
KEPT = Restriction(keep_when_stale=True)
Restrictions = tuple[Restriction | None, ...]


def entries(restrictions: Restrictions) -> tuple[Permission, ...]:
    return tuple(Permission("/pose", Right.SUBSCRIBE, each) for each in restrictions)


def wanted(restrictions: Restrictions, lifetime: int = DAY, renew: int = 0) -> WantedRight:
    return WantedRight(Right.SUBSCRIBE, "/pose", entries(restrictions), (RULE,), lifetime, renew)


def before(restrictions: Restrictions, lifetime: int = DAY, longest: int = DAY) -> Before:
    return Before(frozenset(entries(restrictions)), lifetime, longest)


@pytest.mark.parametrize(
    ("old", "new", "kind"),
    [
        ((None,), (SLOW,), ChangeKind.NARROWER),
        ((SLOW,), (None,), ChangeKind.WIDER),
        ((FAST,), (SLOW,), ChangeKind.NARROWER),
        ((None,), (ROUND,), ChangeKind.NARROWER),
        ((ROUND,), (ROUND, DAYTIME), ChangeKind.NARROWER),
        ((ROUND, DAYTIME), (DAYTIME,), ChangeKind.WIDER),
        ((KEPT,), (None,), ChangeKind.NARROWER),
        ((None,), (KEPT,), ChangeKind.WIDER),
        ((ROUND,), (COARSE,), ChangeKind.CHANGED),
        ((ROUND,), (SLOW,), ChangeKind.CHANGED),
        ((KEPT,), (FAST,), ChangeKind.NARROWER),
        ((ROUND, SLOW), (ROUND, SLOW), ChangeKind.KEPT),
    ],
)
def test_restrictions_are_compared(old: Restrictions, new: Restrictions, kind: ChangeKind) -> None:
    assert change_of(X, wanted(new), before(old)).kind is kind


@pytest.mark.parametrize(
    ("lifetime", "renew", "kind"),
    [
        (DAY, 0, ChangeKind.KEPT),
        (2 * DAY, 0, ChangeKind.WIDER),
        (DAY // 2, 0, ChangeKind.NARROWER),
        (DAY, 30 * DAY, ChangeKind.WIDER),
        (DAY // 2, 30 * DAY, ChangeKind.CHANGED),
    ],
)
def test_validities_are_compared(lifetime: int, renew: int, kind: ChangeKind) -> None:
    assert change_of(X, wanted((None,), lifetime, renew), before((None,))).kind is kind


def test_a_new_right_has_its_rule_and_its_restrictions() -> None:
    change = change_of(X, wanted((ROUND, SLOW), renew=30 * DAY))
    assert change == Change(
        ChangeKind.NEW,
        X,
        Right.SUBSCRIBE,
        "/pose",
        ("at most 1 message a second", "pose.position: round step 2.0", "valid 1d, renewed until 30d"),
        (RULE,),
    )


def test_a_changed_right_shows_what_it_was() -> None:
    change = change_of(X, wanted((FAST,)), before((SLOW,), 2 * DAY, 9 * DAY))
    assert change.before == ("at most 1 message a second", "valid 2d, renewed until 9d")
    assert change_of(X, wanted((FAST,)), before((FAST,))).before == ()


def test_a_right_that_goes_has_the_rules_that_deny_it() -> None:
    policy = rules("{id: d, who: /x, deny: {subscribe: [/pose]}}")
    atom = (Right.SUBSCRIBE, "/pose")
    for subject, ids in ((X, ["d"]), (node("/y"), [])):
        verdict = Decider(policy).decide(subject, *atom)
        change = withdrawn(subject, atom, verdict, before((ROUND,)))
        assert (change.kind, [rule.id for rule in change.rules]) == (ChangeKind.GONE, ids)
        assert change.restrictions == ("pose.position: round step 2.0",)


def test_a_kept_right_says_what_it_is() -> None:
    change = change_of(X, wanted((None,)), is_kept=True)
    assert change.kind is ChangeKind.KEPT
    assert change.restrictions == ("valid 1d",)


def test_each_kind_has_its_sign() -> None:
    assert "".join(kind.sign for kind in ChangeKind) == "+~~~-="
