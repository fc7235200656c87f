"""The subjects of a rule, and the type of a topic."""

import pytest

from grants.model import Right
from grants.policy.model import Clause, Defaults, Effect, Policy, PolicyRule, SubjectPattern, type_of
from tests.grants.policy.policies import HEATING, HEATING_KEY, node

NAMED = SubjectPattern("heating", "/heating", HEATING_KEY)
BY_KEY = SubjectPattern("anywhere", None, HEATING_KEY)


@pytest.mark.parametrize(
    ("who", "name", "key", "admitted", "suspected"),
    [
        (NAMED, "/heating", HEATING_KEY, True, True),
        (NAMED, "/heating", bytes(32), False, True),
        (NAMED, "/other", HEATING_KEY, False, True),
        (NAMED, "/other", bytes(32), False, False),
        (BY_KEY, "/other", HEATING_KEY, True, True),
        (BY_KEY, "/other", bytes(32), False, False),
        (SubjectPattern("nav", "/nav/**"), "/nav/a", bytes(32), True, True),
        (SubjectPattern("nav", "/nav/**"), "/navy/a", bytes(32), False, False),
        # what names no domain matches no foreigner, but a denial of everybody is one of them too
        (SubjectPattern("*", "/**"), "/remote/hospital/a", bytes(32), False, True),
        (SubjectPattern("/*/*/*", "/*/*/*"), "/remote/hospital/a", bytes(32), False, True),
        (BY_KEY, "/remote/hospital/a", HEATING_KEY, False, True),
        (SubjectPattern("h:/*", "/remote/hospital/*"), "/remote/hospital/a", bytes(32), True, True),
        (SubjectPattern("h:/*", "/remote/hospital/*"), "/remote/clinic/a", bytes(32), False, False),
        (SubjectPattern("h:/*", "/remote/hospital/*"), "/hospital/a", bytes(32), False, False),
    ],
)
def test_allowing_needs_name_and_key_denying_either(
    who: SubjectPattern, name: str, key: bytes, admitted: bool, suspected: bool
) -> None:
    assert who.matches(node(name, key)) is admitted
    assert who.may_match(node(name, key)) is suspected


def rule(effect: Effect, *, exceptions: tuple[SubjectPattern, ...] = ()) -> PolicyRule:
    return PolicyRule("r", effect, (NAMED,), (), exceptions=exceptions)


def test_a_denial_applies_on_a_partial_match_an_exception_on_a_full_one() -> None:
    assert rule(Effect.DENY).applies_to(node("/heating"))
    assert not rule(Effect.ALLOW).applies_to(node("/heating"))
    assert rule(Effect.ALLOW).applies_to(HEATING)
    assert not rule(Effect.DENY, exceptions=(NAMED,)).applies_to(HEATING)
    assert rule(Effect.DENY, exceptions=(NAMED,)).applies_to(node("/heating"))


def test_rules_as_text() -> None:
    assert rule(Effect.DENY, exceptions=(BY_KEY,)).subjects_text == "heating except anywhere"
    assert rule(Effect.DENY).subjects_text == "heating"
    assert rule(Effect.DENY).reason == "rule r"
    assert Clause(Right.SUBSCRIBE, "/a", None, 0.5).lines() == ["at most 0.5 messages a second"]
    assert Clause(Right.SUBSCRIBE, "/a").lines() == []


def test_the_type_of_a_topic() -> None:
    types = {"/a": "x/A", "/b/**": "x/B", "/b/*": "x/B", "/c/*": "x/C", "/*/c": "x/D"}
    assert type_of(types, "/a") == "x/A"
    assert type_of(types, "/b/c/d") == "x/B"
    assert type_of(types, "/b/**") == "x/B"
    assert type_of(types, "/b/d/*") is None
    assert type_of(types, "/c/c") is None  # two patterns disagree
    assert type_of(types, "/z") is None
    assert Policy("r", Defaults(), {}, types, ()).type_of("/a") == "x/A"
