"""What is signed and in force, beside what a policy says."""

import pytest

from grants.model import Grant, Permission, Restriction, Right
from grants.policy.decision import Verdict
from grants.policy.model import Effect
from grants.policy.wanted import in_force, in_force_lines
from tests.grants.authority import COARSE, HOLDER, NOW, granted
from tests.grants.policy.policies import node

SUBSCRIBE, SET = Right.SUBSCRIBE, Right.PARAM_SET


def found(
    grant: Grant, right: Right = SUBSCRIBE, name: str = "/a", now: int = NOW, *revoked: bytes
) -> list[Grant]:
    return in_force([grant], {HOLDER}, right, name, now=now, revoked=revoked)


def test_a_grant_for_the_name_is_in_force_until_it_ends() -> None:
    grant = granted(Permission("/a", SUBSCRIBE))
    assert found(grant) == [grant]
    assert found(grant, now=grant.expires) == []
    assert found(grant, now=grant.not_before - 1) == []
    assert found(grant, Right.PUBLISH) == []
    assert found(grant, name="/b") == []
    assert in_force([grant], set(), SUBSCRIBE, "/a", now=NOW, revoked=()) == []


@pytest.mark.parametrize("what", ["grant", "key"])
def test_a_revoked_grant_is_not_in_force(what: str) -> None:
    grant = granted(Permission("/a", SUBSCRIBE))
    assert found(grant, SUBSCRIBE, "/a", NOW, grant.id if what == "grant" else HOLDER) == []


@pytest.mark.parametrize(
    ("pattern", "right", "name"),
    [("/a/**", SUBSCRIBE, "/a/b"), ("/a/b", SUBSCRIBE, "/a/**"), ("/a", SET, "/a/b/c"), ("/a/b", SET, "/a")],
)
def test_a_part_counts(pattern: str, right: Right, name: str) -> None:
    assert found(granted(Permission(pattern, right)), right, name)


def said(grant: Grant, effect: Effect, right: Right = SUBSCRIBE, name: str = "/a") -> list[str]:
    verdict = Verdict(effect, node("/heating"), right, name)
    return in_force_lines(found(grant, right, name), verdict)


def test_it_is_said_if_the_policy_does_not_allow_it() -> None:
    (line, advice) = said(granted(Permission("/a", SUBSCRIBE)), Effect.DENY)
    assert "gives subscribe /a until" in line
    assert "does not allow" in advice
    assert len(said(granted(Permission("/a", SUBSCRIBE)), Effect.ALLOW)) == 1
    assert said(granted(Permission("/b", SUBSCRIBE)), Effect.DENY) == []


def test_parts_and_restrictions_are_named() -> None:
    (line, _) = said(granted(Permission("/a/b", SET)), Effect.DENY, SET)
    assert "/a/b, a part of it, until" in line
    (line,) = said(granted(Permission("/a", SUBSCRIBE, COARSE)), Effect.ALLOW)
    assert line.endswith(", with restrictions")
    stale = Restriction(keep_when_stale=True)
    (line,) = said(granted(Permission("/a", SUBSCRIBE, stale)), Effect.ALLOW)
    assert not line.endswith(", with restrictions")
