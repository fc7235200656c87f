"""Tail patterns in grants: only about the subject, only for who has the tail, in no chain."""

from dataclasses import replace

import pytest

from ca.encoding import encode
from grants.decision import Reach, authorize, check_tail
from grants.document import from_draft, open_grant, read_claims
from grants.errors import GrantMalformed, GrantMissing, GrantNotHeld
from grants.model import Permission, Right
from tests.grants.authority import CA, HOLDER, NOW, draft, granted, signed_claims

RVIZ = granted(Permission("/rviz~/get_loggers", Right.PROVIDE), subject="/rviz")
NAMES = {
    "/rviz/get_loggers": True,
    "/rviz_1/get_loggers": True,
    "/rviz_1_2/get_loggers": True,
    "/rviz_/get_loggers": False,
    "/rvizx/get_loggers": False,
    "/rviz_1x/set_level": False,
    "/rviz_1/a/get_loggers": False,
    "/other/get_loggers": False,
    "/rviz_1/get_loggers/x": False,
}


def _live(_entry: bytes, _now: int) -> None:
    """Nothing is revoked."""


@pytest.mark.parametrize(("name", "expected"), NAMES.items())
def test_every_place_that_decides_gives_the_same_answer(name: str, expected: bool) -> None:
    assert RVIZ.covers(Right.PROVIDE, name) is expected
    assert Reach.of([RVIZ]).covers(Right.PROVIDE, name) is expected
    assert not Reach.of([RVIZ]).covers(Right.CALL, name)
    if expected:
        authorize([RVIZ], Right.PROVIDE, name, holder=HOLDER, now=NOW, check=_live)
        return
    with pytest.raises(GrantMissing):
        authorize([RVIZ], Right.PROVIDE, name, holder=HOLDER, now=NOW, check=_live)


@pytest.mark.parametrize(
    ("peer", "tail"),
    [("/rviz", False), ("/rviz_1", True), ("/other", True), ("/remote/lab/rviz", True), ("/rvi", True)],
)
def test_who_has_not_the_tail_is_refused(peer: str, tail: bool) -> None:
    with pytest.raises(GrantNotHeld, match="anonymous nodes of /rviz") as refused:
        check_tail(RVIZ, peer, tail=tail)
    assert "--anonymous" in refused.value.hint
    check_tail(granted(), peer, tail=tail)


def test_who_has_the_tail_is_not() -> None:
    check_tail(RVIZ, "/rviz", tail=True)


def test_a_chain_with_one_is_refused() -> None:
    chain = replace(RVIZ, chain=(RVIZ, granted(subject="/rviz")))
    with pytest.raises(GrantNotHeld):
        check_tail(chain, "/rviz", tail=True)


@pytest.mark.parametrize("pattern", ["/other~/a", "/rviz_1~/a", "/rvi~/a", "/a/rviz~/a"])
def test_a_grant_is_about_no_tail_but_its_subjects(pattern: str) -> None:
    own = Permission("/rviz/a", Right.PROVIDE)
    with pytest.raises(GrantMalformed, match="tail pattern of another"):
        draft(own, Permission(pattern, Right.PROVIDE), subject="/rviz")
    claims = from_draft(draft(own, subject="/rviz"), bytes(32))
    assert isinstance(claims, dict)
    forged = {**claims, 9: encode([[pattern, int(Right.PROVIDE)]])}
    with pytest.raises(GrantMalformed, match="tail pattern of another"):
        read_claims(encode(forged), bytes(16))
    with pytest.raises(GrantMalformed):
        open_grant(signed_claims(forged), CA.public_key, NOW)


def test_one_that_may_be_narrowed_is_refused() -> None:
    with pytest.raises(GrantMalformed, match="narrowed"):
        draft(Permission("/rviz~/a", Right.PROVIDE), subject="/rviz", may_narrow=1)
    assert RVIZ.has_tail_patterns
    assert not granted().has_tail_patterns
