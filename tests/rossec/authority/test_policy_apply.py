"""A plan is carried out whole, and only on the record and the policy it was made from."""

from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

import pytest

from ca.errors import StoreError
from grants import document
from grants.policy.difference import Moment
from rossec.authority.policyfile import (
    PlanOptions,
    PolicyFile,
    PolicyPlan,
    grant_outright,
    make_plan,
    revoke_planned,
    sign_each,
    sign_planned,
    take_away,
)
from rossec.authority.signing import SKEW, SigningAuthority
from rossec.errors import AuthorityLocked, ConfigurationError
from tests.support.refusals import refuse_to_sign_for
from tests.support.site import DAY, Site

NOW = 1_800_000_000
POLICY = """rossec: 1
robot: r
rules:
  - {id: a, who: "*", allow: {subscribe: [/pose]}}
  - {id: b, who: /robot, allow: {publish: [/odom]}}
"""


class Applied:
    def __init__(self, root: Path) -> None:
        self.site = Site(root / "site", clock=lambda: NOW)
        for name in ("/robot", "/viewer"):
            self.site.enroll(name, 30 * DAY)
        self.path = root / "policy.yaml"
        self.write(POLICY)

    def write(self, text: str) -> None:
        self.path.write_text(text)

    def plan(self) -> PolicyPlan:
        policy = PolicyFile.read(self.path)
        return make_plan(self.site.authority.store, policy, PlanOptions(), Moment(NOW, SKEW))

    def grants(self) -> list[str]:
        store = self.site.authority.store
        rules = store.policy_grants()
        return sorted(f"{row.name} {rules[row.id]}" for row in store.unrevoked_grants())


@pytest.fixture
def applied(tmp_path: Path) -> Iterator[Applied]:
    made = Applied(tmp_path)
    yield made
    made.site.authority.store.close()


def test_what_is_new_is_signed_and_what_goes_is_revoked(applied: Applied) -> None:
    authority = applied.site.authority
    signed = sign_planned(authority, applied.plan(), NOW)
    assert applied.grants() == ["/robot a", "/robot b", "/viewer a"]
    assert [document.peek(data).subject for _, data in signed] == ["/robot", "/robot", "/viewer"]
    assert revoke_planned(authority, applied.plan(), NOW) is None
    assert sign_planned(authority, applied.plan(), NOW) == []
    applied.write(POLICY.replace("/pose", "/map"))
    made = applied.plan()
    sign_planned(authority, made, NOW)
    assert len(applied.grants()) == 5  # the new ones and the old ones
    listed = revoke_planned(authority, made, NOW)
    assert listed is not None
    assert listed.entries == {grant.id for grant in made.revoke}
    assert applied.grants() == ["/robot a", "/robot b", "/viewer a"]
    assert applied.plan().is_empty
    authority.store.log.audit(authority.signer.public_key)


def test_cut_off_between_the_two_the_next_plan_revokes_the_old(applied: Applied) -> None:
    authority = applied.site.authority
    sign_planned(authority, applied.plan(), NOW)
    applied.write(POLICY.replace("/pose", "/map"))
    sign_planned(authority, applied.plan(), NOW)
    again = applied.plan()
    assert (again.signs, len(again.revoke)) == (0, 2)


def test_a_policy_changed_meanwhile_signs_nothing(applied: Applied) -> None:
    made = applied.plan()
    applied.write(POLICY.replace("/pose", "/map"))
    with pytest.raises(ConfigurationError, match="was changed while"):
        sign_planned(applied.site.authority, made, NOW)
    assert applied.grants() == []


def test_a_record_changed_meanwhile_signs_nothing(applied: Applied) -> None:
    """Two commands at the same time: the grants of the other are found."""
    first, second = applied.plan(), applied.plan()
    sign_planned(applied.site.authority, first, NOW)
    with pytest.raises(ConfigurationError, match="record was changed meanwhile") as refused:
        sign_planned(applied.site.authority, second, NOW)
    assert "run the command again" in refused.value.hint
    assert len(applied.grants()) == 3


def test_another_entry_of_the_record_does_no_harm(applied: Applied) -> None:
    made = applied.plan()
    applied.site.authority.store.log_event("test", "other", "", NOW)
    assert len(sign_planned(applied.site.authority, made, NOW)) == 3


def test_a_key_revoked_meanwhile_signs_nothing(applied: Applied) -> None:
    made = applied.plan()
    applied.site.revoke(applied.site.identity("/robot").thumbprint)
    with pytest.raises((StoreError, ConfigurationError)):
        sign_planned(applied.site.authority, made, NOW)
    assert applied.grants() == []


def test_one_node_gets_what_the_policy_gives_it(applied: Applied) -> None:
    authority, policy = applied.site.authority, PolicyFile.read(applied.path)
    assert len(grant_outright(authority, policy, ["/robot"], NOW)) == 2
    assert grant_outright(authority, policy, ["/robot"], NOW) == []
    assert grant_outright(authority, policy, ["/nobody"], NOW) == []
    assert applied.grants() == ["/robot a", "/robot b"]


def test_what_is_only_taken_away_goes_first(applied: Applied) -> None:
    authority = applied.site.authority
    sign_planned(authority, applied.plan(), NOW)
    made = applied.plan()
    assert take_away(authority, made, NOW) == (None, made)
    applied.write(POLICY.replace('who: "*"', "who: /robot").replace("/odom", "/map"))
    made = applied.plan()
    listed, left = take_away(authority, made, NOW)
    assert listed is not None
    assert listed.entries == {grant.id for grant in made.taken}
    assert applied.grants() == ["/robot a"]
    assert (len(made.taken), len(left.revoke), left.signs) == (2, 0, 1)
    sign_planned(authority, left, NOW)
    revoke_planned(authority, left, NOW)
    assert applied.plan().is_empty


def test_a_node_for_which_nothing_can_be_signed_keeps_none_of_the_others(
    applied: Applied, monkeypatch: pytest.MonkeyPatch
) -> None:
    refuse_to_sign_for("/robot", monkeypatch)
    signed, left = sign_each(applied.site.authority, applied.plan(), NOW)
    assert applied.grants() == ["/viewer a"]
    assert [draft.subject for draft, _ in signed] == ["/viewer"]
    assert left.refused == ("/robot: too large",)
    assert left.revoke == ()


def test_refusals_about_the_key_are_of_all(applied: Applied, monkeypatch: pytest.MonkeyPatch) -> None:
    def locked(*_: object) -> NoReturn:
        raise AuthorityLocked("the key is locked")

    monkeypatch.setattr(SigningAuthority, "issue_grants", locked)
    with pytest.raises(AuthorityLocked):
        sign_each(applied.site.authority, applied.plan(), NOW)
    assert applied.grants() == []
