"""The index finds exactly what comparing every clause finds, at constant cost."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.names import pattern_covers
from grants.model import ALL_RIGHTS, Right
from grants.policy.decision import Index, hits
from grants.policy.model import Clause, Defaults, Effect, Policy, PolicyRule, Subject, SubjectPattern

KEYS = (bytes(32), bytes([1]) * 32)
segment = st.sampled_from(["a", "a_b", "b"])
name = st.lists(segment, min_size=1, max_size=4).map(lambda parts: "/" + "/".join(parts))
pattern = st.lists(st.sampled_from(["a", "b", "*", "**"]), min_size=1, max_size=4).map(
    lambda parts: "/" + "/".join(parts)
)
key = st.sampled_from([None, *KEYS])
who = st.one_of(
    st.builds(SubjectPattern, st.just("w"), pattern | name, key),
    st.builds(SubjectPattern, st.just("k"), st.none(), st.sampled_from(KEYS)),
)
right = st.sampled_from(list(ALL_RIGHTS))
own = st.sampled_from(["{node}", "{node}/a", "{node}/**", "{node}/*/b"])
clause = st.builds(Clause, right, pattern | own)
rule = st.builds(
    PolicyRule,
    id=st.text("rst", min_size=1, max_size=3),
    effect=st.sampled_from(Effect),
    who=st.lists(who, min_size=1, max_size=2).map(tuple),
    clauses=st.lists(clause, min_size=1, max_size=3).map(tuple),
    exceptions=st.lists(who, max_size=1).map(tuple),
)
subject = st.builds(Subject, name, st.sampled_from(KEYS), st.booleans())
policies = st.lists(rule, max_size=8).map(lambda made: of(*made))


def of(*made: PolicyRule) -> Policy:
    return Policy("r", Defaults(), {}, {}, made)


@given(policies, subject, right, name | pattern)
def test_the_index_finds_what_comparing_all_clauses_finds(
    policy: Policy, asking: Subject, asked: Right, about: str
) -> None:
    found = Index(policy).find(asking, asked, about)
    expected = list(hits(policy.rules, asking, asked, about))
    assert sorted(map(repr, found)) == sorted(map(repr, expected))


@given(policies, subject, name)
def test_an_exact_subscription_is_found_by_covering_patterns_alone(
    policy: Policy, asking: Subject, about: str
) -> None:
    for _, found in Index(policy).find(asking, Right.SUBSCRIBE, about):
        assert pattern_covers(found.pattern, about)


def test_a_right_without_clauses_finds_nothing() -> None:
    assert Index(of()).find(Subject("/a", KEYS[0]), Right.CALL, "/b") == []


@pytest.mark.parametrize(("asked", "found"), [("/a", 1), ("/a/b", 1), ("/a/b/c", 1), ("/b", 0)])
def test_a_denial_below_denies_the_parameter_above(asked: str, found: int) -> None:
    deny = PolicyRule("d", Effect.DENY, (SubjectPattern("x", "/x"),), (Clause(Right.PARAM_SET, "/a/b"),))
    index = Index(of(deny))
    assert len(index.find(Subject("/x", KEYS[0]), Right.PARAM_SET, asked)) == found


def test_the_cost_does_not_grow_with_rules_on_other_names(monkeypatch: pytest.MonkeyPatch) -> None:
    compared: list[str] = []

    def compare(rule: PolicyRule, _: Subject) -> bool:
        compared.append(rule.id)
        return True

    monkeypatch.setattr(PolicyRule, "applies_to", compare)
    made = [
        PolicyRule(f"r{n}", Effect.ALLOW, (SubjectPattern("w", f"/n{n}"),), (Clause(Right.CALL, f"/s{n}"),))
        for n in range(500)
    ]
    assert len(Index(of(*made)).find(Subject("/n7", KEYS[0]), Right.CALL, "/s7")) == 1
    assert compared == ["r7"]


@given(policies, subject)
def test_the_rules_of_a_node_are_those_that_apply(policy: Policy, asking: Subject) -> None:
    found = Index(policy).rules_of(asking)
    assert found == [rule for rule in policy.rules if rule.applies_to(asking)]
