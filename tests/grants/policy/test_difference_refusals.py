"""What one node cannot get is said of it, and stops nothing: neither what goes nor what is kept."""

from itertools import count
from typing import Final

from grants.model import Draft, Grant, Right
from grants.policy.decision import Decider
from grants.policy.difference import MAX_PRESENTED, Moment, NodeDifference, RecordedGrant, difference
from grants.policy.model import Policy
from grants.policy.wanted import WantedState, drafts, rule_ids
from tests.grants.policy.policies import node, rules

NOW: Final = 1_800_000_000
X: Final = node("/x")
WIDE: Final = '{id: wide, who: /x, allow: {call: ["/s/*"]}}'
_ids = count(1)


def asked(policy: Policy, *names: str) -> list[RecordedGrant]:
    """A grant for each right that the node asked for, as a decision of its request records it."""
    found = []
    for name in names:
        verdict = Decider(policy).decide(X, Right.CALL, name)
        (draft,) = drafts([verdict], domain="home", now=NOW, serial=lambda: bytes(16))
        found.append(RecordedGrant(_grant(draft), rule_ids(verdict.rules)))
    return found


def _grant(draft: Draft) -> Grant:
    return Grant.of(draft, id=next(_ids).to_bytes(16), issuer=bytes(32))


def compare(policy: Policy, recorded: list[RecordedGrant]) -> NodeDifference:
    return difference(WantedState(Decider(policy)), X, recorded, Moment(NOW))


def signed(found: NodeDifference) -> set[str]:
    return {each.pattern for group in found.sign for each in group}


def test_a_node_that_asked_for_too_many_gets_them_in_fewer_grants() -> None:
    names = [f"/s/n{number}" for number in range(70)]
    policy = rules(WIDE)
    found = compare(policy, asked(policy, *names))
    assert found.refused == ()
    assert signed(found) == {*names, "/s/*"}
    assert len(found.revoke) == 70
    assert found.revoke == found.replaced
    assert found.taken == ()


def test_what_shares_a_grant_from_now_on_is_signed_again() -> None:
    """25 requests and a new rule: all that goes is computed before what is signed."""
    names = [f"/s/n{number}" for number in range(26)]
    before = rules('{id: wide, who: /x, allow: {call: ["/s/*"]}}')
    after = rules(WIDE, "{id: new, who: /x, allow: {publish: [/new]}}")
    found = compare(after, asked(before, *names))
    gone = {item.pattern for grant in found.revoke for item in grant.permissions}
    assert gone == set(names)
    assert signed(found) == {*names, "/s/*", "/new"}


def test_a_node_with_too_many_still_loses_what_is_taken_away() -> None:
    many = ", ".join(f"/m{number}" for number in range(MAX_PRESENTED * 64 + 1))
    before = rules(WIDE)
    after = rules(f"{{id: many, who: /x, allow: {{call: [{many}]}}}}")
    camera = asked(before, "/s/camera")
    found = compare(after, camera)
    assert found.sign == ()
    assert found.refused
    assert found.taken == (camera[0].grant,)


def test_a_right_too_large_for_a_grant_is_refused_alone() -> None:
    """Each rule alone is small; together their conditions are more than a grant can have."""
    head = "rossec: 1\nrobot: r\n"
    large = [
        f"{{id: r{number}, who: /x, allow: {{subscribe: [/p]}},"
        f' when: \'now.getHours("UTC") >= 0 && "{number}{"a" * 900}" != "b"\'}}'
        for number in range(20)
    ]
    policy = rules(*large, "{id: small, who: /x, allow: {publish: [/q]}}", head=head)
    found = compare(policy, [])
    assert signed(found) == {"/q"}
    (refused,) = found.refused
    assert refused.startswith("/x: subscribe /p (rules r0 ")
    assert refused.endswith("its conditions and filters are too large for one grant")
    kept = found.without_signing("the key is gone")
    assert (kept.sign, kept.refused[1]) == ((), "/x: the key is gone")
