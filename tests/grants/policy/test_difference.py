"""What is exact is kept, the rest goes, what is missing is signed; then nothing is left to do."""

from collections.abc import Iterable
from dataclasses import replace
from itertools import count

import pytest
from hypothesis import given
from hypothesis import strategies as st

from grants.decision import authorize
from grants.errors import GrantMissing
from grants.model import Grant, Permission, Right, merge
from grants.policy.decision import Decider
from grants.policy.difference import (
    MAX_GRANTS,
    MAX_PRESENTED,
    ChangeKind,
    Moment,
    NodeDifference,
    RecordedGrant,
    atoms,
    difference,
)
from grants.policy.model import DAY, Clause, Defaults, Effect, Policy, PolicyRule, Subject, SubjectPattern
from grants.policy.wanted import WantedState, rule_ids
from tests.grants.policy.policies import HEADER, node, rules

NOW, SKEW = 1_800_000_000, 60
MOMENT = Moment(NOW, SKEW)
X = node("/x")
_ids = count(1)


def compare(
    policy: Policy, *recorded: RecordedGrant, moment: Moment = MOMENT, gets: bool = True
) -> NodeDifference:
    return difference(WantedState(Decider(policy)), X, recorded, moment, gets=gets)


def signed(found: NodeDifference, now: int = NOW, subject: Subject = X) -> list[RecordedGrant]:
    """What the authority records for a difference."""
    return [
        RecordedGrant(
            Grant(
                "home",
                subject.name,
                subject.key,
                now - SKEW,
                now + group[0].lifetime,
                now + max(group[0].lifetime, group[0].renew_until),
                bytes(16),
                tuple(item for each in group for item in each.permissions),
                next(_ids).to_bytes(16),
                bytes(32),
            ),
            rule_ids(rule for each in group for rule in each.rules),
        )
        for group in found.sign
    ]


def applied(policy: Policy, *recorded: RecordedGrant) -> list[RecordedGrant]:
    """The grants in force after applying."""
    found = compare(policy, *recorded)
    return [each for each in recorded if each.grant not in found.revoke] + signed(found)


def by_hand(pattern: str, right: Right = Right.SUBSCRIBE) -> RecordedGrant:
    grant = Grant(
        "home",
        "/x",
        X.key,
        NOW,
        NOW + DAY,
        NOW + DAY,
        bytes(16),
        (Permission(pattern, right),),
        next(_ids).to_bytes(16),
        bytes(32),
    )
    return RecordedGrant(grant)


def shown(found: NodeDifference) -> list[str]:
    return [
        f"{each.kind.sign} {each.right.label} {each.pattern}"
        for each in found.changes
        if each.kind is not ChangeKind.KEPT
    ]


A = "{id: a, who: /x, allow: {subscribe: [/a], publish: [/b]}}"
B = "{id: b, who: /x, allow: {call: [/c]}}"


def test_each_set_of_rules_is_a_grant() -> None:
    found = compare(rules(A, B))
    assert shown(found) == ["+ subscribe /a", "+ publish /b", "+ call /c"]
    assert [each.rules for each in signed(found)] == ["a", "b"]
    assert found.ends == NOW + 7 * DAY
    again = compare(rules(A, B), *signed(found))
    assert (shown(again), again.sign, again.revoke) == ([], (), ())
    assert [each.kind for each in again.changes] == [ChangeKind.KEPT] * 3


def test_a_changed_rule_touches_no_grant_of_another() -> None:
    first, second = applied(rules(A, B))
    found = compare(rules(A, B.replace("/c", "/d")), first, second)
    assert shown(found) == ["+ call /d", "- call /c"]
    assert found.revoke == (second.grant,)
    assert len(found.sign) == 1


def test_a_rule_that_gives_more_keeps_what_it_gave() -> None:
    (first,) = applied(rules(A))
    found = compare(rules(A.replace("[/a]", "[/a, /more]")), first)
    assert (shown(found), found.revoke) == (["+ subscribe /more"], ())


def test_a_rule_that_gives_less_signs_the_rest_anew() -> None:
    (first,) = applied(rules(A))
    found = compare(rules(A.replace(", publish: [/b]", "")), first)
    assert (shown(found), found.revoke) == (["- publish /b"], (first.grant,))
    assert [each.pattern for group in found.sign for each in group] == ["/a"]


def test_a_restriction_replaces_the_grant() -> None:
    (first,) = applied(rules(B.replace("call", "subscribe")))
    found = compare(rules(B.replace("call", "subscribe")[:-1] + ", limit: {rate: 1}}"), first)
    assert (shown(found), found.revoke) == (["~ subscribe /c"], (first.grant,))
    assert found.changes[0].kind is ChangeKind.NARROWER


def test_a_denial_takes_what_was_given() -> None:
    first, second = applied(rules(A, B))
    found = compare(rules(A, B, "{id: d, who: /x, deny: {call: [/c]}}"), first, second)
    assert shown(found) == ["- call /c"]
    assert [rule.id for rule in found.changes[-1].rules] == ["d"]
    assert found.revoke == (second.grant,)
    assert [each.by.id for each in found.withheld] == ["d"]


def test_what_was_given_on_request_stays_while_the_policy_says_the_same() -> None:
    """The pattern is withheld for one denied name, and the node asked for another."""
    wide = '{id: a, who: /x, allow: {subscribe: ["/r/**"]}}'
    deny = "{id: d, who: /x, deny: {subscribe: [/r/no]}}"
    asked = compare(rules("{id: a, who: /x, allow: {subscribe: [/r/pose]}}"))
    (given_on_request,) = signed(asked)
    assert compare(rules(wide, deny), given_on_request).revoke == ()
    limited = wide[:-1] + ", limit: {rate: 1}}"
    found = compare(rules(limited, deny), given_on_request)
    assert (shown(found), found.revoke) == (["~ subscribe /r/pose"], (given_on_request.grant,))
    found = compare(rules(deny), given_on_request)
    assert (shown(found), found.sign) == (["- subscribe /r/pose"], ())


def test_grants_by_hand_are_left_alone_and_named_if_denied() -> None:
    deny = "{id: d, who: /x, deny: {subscribe: [/a/**]}}".replace("/a/**", '"/a/**"')
    hand = [by_hand("/a/b"), by_hand("/**"), by_hand("/other"), by_hand("/a/b", Right.PUBLISH)]
    found = compare(rules(deny), *hand)
    assert (found.revoke, found.sign) == ((), ())
    assert [(each.grant, each.pattern, each.rule.id) for each in found.contradictions] == [
        (hand[0].grant, "/a/b", "d"),
        (hand[1].grant, "/**", "d"),
    ]


def test_a_node_without_a_valid_identity_only_loses() -> None:
    first, second = applied(rules(A, B))
    assert compare(rules(A, B), first, second, gets=False).revoke == ()
    found = compare(rules(B), first, second, gets=False)
    assert (found.revoke, found.sign) == ((first.grant,), ())
    assert compare(rules(A), gets=False).sign == ()


@pytest.mark.parametrize(("later", "signs", "due"), [(4 * DAY, 0, 0), (5 * DAY, 0, 1), (7 * DAY, 1, 0)])
def test_what_has_ended_is_signed_and_what_ends_soon_is_named(later: int, signs: int, due: int) -> None:
    given_ = applied(rules(A))
    found = compare(rules(A), *given_, moment=Moment(NOW + later, SKEW))
    assert (len(found.sign), len(found.due), found.revoke) == (signs, due, ())


def test_what_is_due_is_renewed_when_asked_and_only_once() -> None:
    (old,) = applied(rules(A))
    later = NOW + 5 * DAY
    moment = Moment(later, SKEW, renew_due=True)
    found = compare(rules(A), old, moment=moment)
    assert (len(found.sign), found.revoke, found.due) == (1, (), ())
    assert found.ends == later + 7 * DAY
    again = compare(rules(A), old, *signed(found, later), moment=moment)
    assert (again.sign, again.revoke, again.due) == ((), (), ())


def test_what_the_master_renews_ends_with_its_cap() -> None:
    renewed = A[:-1] + ", renew_until: 90d}"
    given_ = applied(rules(renewed))
    late = Moment(NOW + 30 * DAY, SKEW, renews=True)
    found = compare(rules(renewed), *given_, moment=late)
    assert (found.sign, found.ends) == ((), NOW + 90 * DAY)
    found = compare(rules(renewed), *given_, moment=replace(late, renews=False))
    assert (len(found.sign), found.ends) == (1, NOW + 37 * DAY)


def test_a_changed_validity_replaces_the_grant() -> None:
    given_ = applied(rules(A))
    found = compare(rules(A[:-1] + ", lifetime: 1d}"), *given_)
    assert {each.kind for each in found.changes} == {ChangeKind.NARROWER}
    assert len(found.revoke) == 1


def many(number: int) -> Policy:
    return rules(
        *(f"{{id: r{n}, who: /x, allow: {{call: [/s{n}]}}, lifetime: {n % 2 + 1}d}}" for n in range(number))
    )


def test_many_rules_share_grants_of_the_same_validity() -> None:
    assert len(compare(many(MAX_GRANTS)).sign) == MAX_GRANTS
    given_ = applied(many(MAX_GRANTS))
    found = compare(many(MAX_GRANTS + 1), *given_)
    assert (len(found.sign), len(found.revoke)) == (2, MAX_GRANTS)
    assert shown(found) == [f"+ call /s{MAX_GRANTS}"]
    after = applied(many(MAX_GRANTS + 1), *given_)
    again = compare(many(MAX_GRANTS + 1), *after)
    assert (again.sign, again.revoke) == ((), ())


def test_a_node_with_too_many_grants_is_refused() -> None:
    names = ", ".join(f"/s{n}" for n in range(MAX_PRESENTED * 64 + 1))
    policy = rules(f"{{id: r, who: /x, allow: {{call: [{names}]}}}}")
    found = compare(policy)
    assert found.sign == ()
    (refused,) = found.refused
    assert refused.startswith("/x would need 65 grants where at most 64")
    assert "patterns" in refused


def test_a_grant_has_a_bounded_size() -> None:
    long = ", ".join(f"/{'a' * 200}{n}" for n in range(60))
    found = compare(rules(f"{{id: r, who: /x, allow: {{call: [{long}]}}}}"))
    assert len(found.sign) == 2
    assert sum(len(group) for group in found.sign) == 60


def test_rights_of_one_entry_are_told_apart() -> None:
    entry = Permission("/a", Right.PUBLISH | Right.SUBSCRIBE)
    grant = replace(by_hand("/a").grant, permissions=(entry,))
    assert atoms(grant) == {
        (right, "/a"): frozenset({Permission("/a", right)}) for right in (Right.PUBLISH, Right.SUBSCRIBE)
    }


def test_filters_survive_in_the_record() -> None:
    """Read back from a signed grant, a restriction is still that of the policy."""
    from grants.document import peek, sign
    from grants.model import Draft
    from tests.grants.authority import CA

    policy = rules(
        "{id: r, who: /x, allow: {subscribe: [/pose]}, filter: {pose.position: {round: 2.0}},"
        " limit: {rate: 2}, when: now.getHours() >= 6, on_stale: keep}",
        head=HEADER + "types: {/pose: geometry_msgs/PoseStamped}\n",
    )
    (made,) = signed(compare(policy))
    draft = Draft(**{name: getattr(made.grant, name) for name in Draft.__dataclass_fields__})
    read = RecordedGrant(peek(sign(CA, draft)), "r")
    found = compare(policy, read)
    assert (found.sign, found.revoke) == ((), ())


segment = st.sampled_from(["a", "b"])
name = st.lists(segment, min_size=1, max_size=3).map(lambda parts: "/" + "/".join(parts))
pattern = st.lists(st.sampled_from(["a", "b", "*", "**"]), min_size=1, max_size=3).map(
    lambda parts: "/" + "/".join(parts)
)
RIGHTS = (Right.SUBSCRIBE, Right.PARAM_GET)
who = st.builds(SubjectPattern, st.just("w"), st.sampled_from(["/x", "/**", "/y"]), st.none())
rule = st.builds(
    PolicyRule,
    id=st.text("rst", min_size=1, max_size=3),
    effect=st.sampled_from([Effect.ALLOW, Effect.ALLOW, Effect.DENY, Effect.PROMPT]),
    who=who.map(lambda one: (one,)),
    clauses=st.lists(st.builds(Clause, st.sampled_from(RIGHTS), pattern | name), min_size=1, max_size=3).map(
        tuple
    ),
    lifetime=st.sampled_from([DAY, 2 * DAY]),
)
limited = st.builds(
    lambda item, rate: replace(
        item,
        clauses=tuple(replace(c, rate=rate) for c in item.clauses if c.right is Right.SUBSCRIBE)
        or item.clauses,
    ),
    rule.filter(lambda item: item.effect is not Effect.DENY),
    st.sampled_from([1.0, 2.0]),
)
policies = st.lists(rule | limited, max_size=6).map(lambda made: Policy("r", Defaults(), {}, {}, tuple(made)))


def fresh(bytes_: bytes, now: int) -> None:
    """No grant is revoked."""


def allowed(grants: Iterable[Grant], right: Right, about: str) -> tuple[bool, object]:
    try:
        found = authorize(grants, right, about, holder=X.key, now=NOW, check=fresh)
    except GrantMissing:
        return False, ()
    return True, found.restrictions


@given(policies, policies)
def test_a_second_difference_is_empty(before: Policy, after: Policy) -> None:
    force = applied(after, *applied(before))
    found = compare(after, *force)
    assert (found.sign, found.revoke, found.due) == ((), (), ())
    assert {each.kind for each in found.changes} <= {ChangeKind.KEPT}


@given(policies, policies)
def test_the_grants_in_force_are_what_the_policy_allows(before: Policy, after: Policy) -> None:
    """Whatever was in force before: the same entries as with nothing before, or on request."""
    decider = Decider(after)
    held = [each.grant for each in applied(after, *applied(before))]
    found = {atom: entries for grant in held for atom, entries in atoms(grant).items()}
    for (right, about), entries in found.items():
        verdict = decider.decide(X, right, about)
        assert verdict
        rates = {item.restriction.rate for item in entries if item.restriction is not None}
        assert rates == ({verdict.rate} if verdict.rate is not None else set())
    for each in WantedState(decider).of(X).rights:
        assert found[each.atom] == frozenset(each.permissions)


@given(policies, policies, name, st.sampled_from(RIGHTS))
def test_no_single_grant_gives_more_than_the_policy(
    before: Policy, after: Policy, about: str, right: Right
) -> None:
    """A peer presents only the grants it chooses."""
    verdict = Decider(after).decide(X, right, about)
    for each in applied(after, *applied(before)):
        gives, restrictions = allowed([each.grant], right, about)
        if gives:
            assert verdict, f"{right.label} {about} is not allowed"
            rates = [one.rate for one in merge(restrictions) if one.rate is not None]  # type: ignore[arg-type]
            assert verdict.rate is None or min(rates) <= verdict.rate
