"""Opting out changes the policy first, and then revokes all that shows what it denies."""

from pathlib import Path

import pytest

from ca.errors import StoreError
from grants import document
from grants.model import Draft, Permission, Right
from rossec.authority.policyfile import PolicyFile, add_denial, revoke_shown
from rossec.authority.signing import SigningAuthority
from rossec.errors import ConfigurationError
from tests.support.site import Site

NOW, DAY = 1_800_000_000, 86_400
POLICY = "rossec: 1\nrobot: r\nrules: []\n"
SEES = Permission("/pose", Right.SUBSCRIBE)
OTHER = Permission("/**", Right.GRAPH)


@pytest.fixture
def site(tmp_path: Path) -> Site:
    made = Site(tmp_path / "site", clock=lambda: NOW)
    for name in ("/viewer", "/other"):
        made.enroll(name, DAY)
    return made


@pytest.fixture
def policy(tmp_path: Path) -> PolicyFile:
    path = tmp_path / "policy.yaml"
    path.write_text(POLICY)
    return PolicyFile.read(path)


def grant(site: Site, name: str, *permissions: Permission, expires: int = NOW + DAY) -> bytes:
    holder = site.authority.store.valid_certificate(name, NOW).thumbprint
    draft = Draft("home", name, holder, NOW - 60, expires, NOW + DAY, name.encode().ljust(16), permissions)
    site.authority.issue_grant(draft, NOW)
    return site.authority.store.grants()[-1].id


def test_a_topic_is_denied_to_all(site: Site, policy: PolicyFile) -> None:
    shown = grant(site, "/viewer", SEES, OTHER)
    grant(site, "/other", Permission("/scan", Right.PUBLISH))
    opted_out = add_denial(policy, "/**", NOW, is_node=False)
    assert opted_out.rule == "opt-out-anyany"
    (rule,) = PolicyFile.read(policy.path).policy.rules
    assert (rule.id, rule.effect) == (opted_out.rule, "deny")
    ((found, reissued),) = revoke_shown(site.authority, opted_out, NOW)
    assert found.id == shown
    assert reissued is not None
    left = document.peek(reissued)
    assert (left.permissions, left.expires, left.subject) == ((OTHER,), NOW + DAY, "/viewer")
    assert revoke_shown(site.authority, opted_out, NOW) == []


def test_a_node_is_denied_every_topic(site: Site, policy: PolicyFile) -> None:
    shown = grant(site, "/viewer", SEES)
    grant(site, "/other", SEES)
    opted_out = add_denial(policy, "/viewer", NOW, is_node=True)
    ((found, reissued),) = revoke_shown(site.authority, opted_out, NOW)
    assert (found.id, reissued) == (shown, None)


def test_an_expired_grant_is_revoked_and_not_granted_anew(site: Site, policy: PolicyFile) -> None:
    grant(site, "/viewer", SEES, OTHER, expires=NOW)  # the master could renew it
    opted_out = add_denial(policy, "/pose", NOW, is_node=False)
    ((_, reissued),) = revoke_shown(site.authority, opted_out, NOW)
    assert reissued is None
    grant(site, "/other", SEES)
    assert revoke_shown(site.authority, opted_out, NOW + DAY) == []  # its cap is over


def test_a_policy_changed_meanwhile_is_not_overwritten(policy: PolicyFile) -> None:
    policy.path.write_text(POLICY + "# new\n")
    with pytest.raises(ConfigurationError, match="was changed while"):
        add_denial(policy, "/pose", NOW, is_node=False)


def test_all_grants_are_revoked_or_none(
    site: Site, policy: PolicyFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("/viewer", "/other"):
        grant(site, name, SEES)
    opted_out = add_denial(policy, "/pose", NOW, is_node=False)
    revoke = SigningAuthority.revoke

    def fail_later(authority: SigningAuthority, entry: bytes, reason: str, now: int) -> object:
        if authority.store.revoked_entries():
            raise StoreError("the disk is full")
        return revoke(authority, entry, reason, now)

    monkeypatch.setattr(SigningAuthority, "revoke", fail_later)
    with pytest.raises(StoreError):
        revoke_shown(site.authority, opted_out, NOW)
    assert site.authority.store.revoked_entries() == frozenset()


def test_what_is_left_of_a_grant_of_the_policy_is_of_the_policy(site: Site, policy: PolicyFile) -> None:
    holder = site.authority.store.valid_certificate("/viewer", NOW).thumbprint
    draft = Draft("home", "/viewer", holder, NOW, NOW + DAY, NOW + DAY, bytes(16), (SEES, OTHER))
    site.authority.issue_grant(draft, NOW, "rule")
    opted_out = add_denial(policy, "/pose", NOW, is_node=False)
    ((_, reissued),) = revoke_shown(site.authority, opted_out, NOW)
    assert reissued is not None
    assert site.authority.store.policy_grants()[document.grant_id(reissued)] == "rule"
