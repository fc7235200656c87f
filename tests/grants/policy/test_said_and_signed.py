"""Random policies against the real decisions: what is said of a right is what its grants give.

Said by `Decider` (explain, reports, the console), by the tests of a policy and by `in_force`; given
by `authorize`, as every node decides, and by `Reach`, as the master does.
"""

from dataclasses import replace

from hypothesis import assume, given, settings
from hypothesis import strategies as st

from grants.decision import Reach, authorize
from grants.errors import GrantMissing
from grants.model import MESSAGE_RIGHTS, TREE_RIGHTS, Grant, Restriction, Right
from grants.policy.assertion_check import check_tests
from grants.policy.assertions import CheckedClaim, PolicyTest, Says
from grants.policy.decision import Decider
from grants.policy.model import Clause, Effect, Policy, PolicyRule, Subject
from grants.policy.wanted import WantedState, in_force
from rossec.authority.policyfile import layout_of
from tests.grants.policy.test_index import KEYS, name, of, own, pattern, right, subject, who

NOW = 1_800_000_000
restrictions = st.sampled_from(
    [None, Restriction(conditions=("now.getHours() >= 8",)), Restriction(conditions=("1 == 1",))]
)
clauses = st.builds(Clause, right, pattern | name | own, restrictions).map(
    lambda made: made if made.right & MESSAGE_RIGHTS else replace(made, restriction=None)
)
allowing = st.builds(
    PolicyRule,
    id=st.text("rst", min_size=1, max_size=3),
    effect=st.sampled_from([Effect.ALLOW, Effect.ALLOW, Effect.ALLOW, Effect.DENY, Effect.PROMPT]),
    who=st.lists(who, min_size=1, max_size=2).map(tuple),
    clauses=st.lists(clauses, min_size=1, max_size=3).map(tuple),
    lifetime=st.sampled_from([3600, 86400, 30 * 86400]),
)
policies = st.lists(allowing, min_size=1, max_size=6).map(lambda made: of(*made))


def signed(policy: Policy, asking: Subject) -> list[Grant]:
    """What `policy apply` signs for the node: each right alone, as long as it may be."""
    wanted = WantedState(Decider(policy)).of(asking).rights
    return [
        Grant(
            domain="home",
            subject=asking.name,
            holder=asking.key,
            not_before=NOW,
            expires=NOW + each.lifetime,
            cap=NOW + each.lifetime,
            serial=bytes(16),
            permissions=each.permissions,
            id=at.to_bytes(16, "big"),
            issuer=bytes(32),
        )
        for at, each in enumerate(wanted)
    ]


def never(_id: bytes, _now: int) -> None:
    return None


@settings(deadline=None, max_examples=80)
@given(st.data(), policies, subject)
def test_what_is_said_of_a_right_is_what_every_grant_gives(
    data: st.DataObject, policy: Policy, asking: Subject
) -> None:
    grants = signed(policy, asking)
    assume(grants)
    given_by = data.draw(st.sampled_from(grants))
    asked = data.draw(st.sampled_from(list(given_by.permissions[0].rights)))
    near = given_by.permissions[0].pattern
    below = f"{near}/a" if asked & TREE_RIGHTS else near
    about = data.draw(st.sampled_from([near, below])).replace("**", "a/b").replace("*", "b")
    assume("~" not in about)
    verdict = Decider(policy).decide(asking, asked, about)
    found = in_force(grants, {asking.key}, asked, about, now=NOW, revoked=())
    covering = [grant for grant in grants if grant.covers(asked, about)]
    assert {grant.id for grant in covering} <= {grant.id for grant in found}
    assert Reach.of(grants).covers(asked, about) is bool(covering)
    for grant in covering:  # a node presents the one it chooses
        decision = authorize([grant], asked, about, holder=asking.key, now=NOW, check=never)
        assert verdict.effect is Effect.ALLOW
        assert decision.expires - NOW <= verdict.lifetime
        assert set(verdict.restrictions) <= set(decision.restrictions)


@settings(deadline=None, max_examples=80)
@given(policies, subject, right, name)
def test_what_a_test_says_may_not_be_is_given_by_no_grant(
    policy: Policy, asking: Subject, asked: Right, about: str
) -> None:
    claim = CheckedClaim(Says.MAY_NOT, asked, about, 1)
    test = PolicyTest(Subject(asking.name, KEYS[0]), (claim,))
    (outcome,) = check_tests(replace(policy, tests=(test,)), layout_of)
    if not outcome:
        return
    for key in KEYS:
        grants = signed(policy, Subject(asking.name, key))
        assert not in_force(grants, {key}, asked, about, now=NOW, revoked=())
        try:
            authorize(grants, asked, about, holder=key, now=NOW, check=never)
        except GrantMissing:
            continue
        raise AssertionError((key, about))
