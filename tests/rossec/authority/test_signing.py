"""What the unlocked authority signs, on a site whose key is in memory."""

from pathlib import Path

import pytest

from ca.certificates import from_pem
from ca.errors import StoreError
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from ca.revocation.lists import RevocationList, is_tree, open_list, open_tree
from ca.revocation.trust_status import open_statement
from ca.svid import build_request, check_request
from grants import document
from grants.model import Draft, Permission, Right
from grants.renewal import open_delegation
from rossec.authority import signing
from rossec.authority.signing import OWN_NODE, SigningAuthority
from rossec.errors import ConfigurationError
from tests.rossec.authority.test_renewals import below
from tests.support.site import Site

NOW, DAY = 1_800_000_000, 86_400


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site", clock=lambda: NOW)


@pytest.fixture
def opened(site: Site) -> SigningAuthority:
    return site.authority


def request(name: str = "/robot") -> bytes:
    return build_request(KeySigner(generate()), "home", name)


def newest(opened: SigningAuthority) -> bytes:
    data = opened.store.newest_list()
    assert data is not None
    return data


def listed_entries(opened: SigningAuthority) -> frozenset[bytes]:
    return open_list(newest(opened), opened.signer.public_key).entries


def draft(holder: bytes = bytes(32)) -> Draft:
    return Draft(
        "home", "/a", holder, NOW, NOW + 10, NOW + 1000, bytes(16), (Permission("/t", Right.PUBLISH),)
    )


def test_a_repeated_request_gets_the_same_certificate(opened: SigningAuthority) -> None:
    csr = request()
    bundle = opened.issue(csr, NOW, DAY)
    assert opened.issue(csr, NOW + 60) == bundle
    leaf, root = from_pem(bundle)
    assert opened.verify(leaf, NOW).name == "/robot"
    assert root == opened.authority.anchor.certificate
    with pytest.raises(StoreError, match="that identity is invalid or differs"):
        opened.issue(csr, NOW, wildcard=True)
    with pytest.raises(StoreError, match="the identity of /robot ended on") as caught:
        opened.issue(csr, NOW + DAY + 1)
    assert "rossec ca renew --expired /robot" in caught.value.hint


def test_a_denied_request_and_a_revoked_key_get_nothing(opened: SigningAuthority) -> None:
    denied, revoked = request("/denied"), request("/revoked")
    asked = check_request(denied, "home")
    opened.store.requests.add(asked, denied, "test", NOW)
    opened.store.requests.deny(asked.digest, NOW, "unknown")
    with pytest.raises(StoreError, match="is denied and cannot be issued"):
        opened.issue(denied, NOW)
    opened.issue(revoked, NOW)
    assert opened.revoke_identity("/revoked", "lost", NOW)[1] == 1
    with pytest.raises(StoreError, match="the key of /revoked is revoked"):
        opened.issue(revoked, NOW)


def test_a_replaced_key_is_revoked_with_its_successor(opened: SigningAuthority) -> None:
    old = check_request(request(), "home")
    opened.issue(first := request(), NOW)
    opened.issue(request(), NOW, replace_key="/robot")
    assert check_request(first, "home").thumbprint in listed_entries(opened)
    assert old.thumbprint not in listed_entries(opened)


def test_a_revocation_is_signed_and_numbered(opened: SigningAuthority) -> None:
    listed = opened.revoke(b"g" * 16, "test", NOW)
    assert open_list(newest(opened), opened.signer.public_key) == listed
    assert listed.entries == {b"g" * 16}
    assert opened.revoke(b"g" * 16, "again", NOW).seq == listed.seq + 1


def test_a_new_epoch_is_newer_than_every_list_before(opened: SigningAuthority) -> None:
    assert opened.sign_list(NOW, new_epoch=True).number == (NOW, 1)
    assert opened.sign_list(NOW, new_epoch=True).number == (NOW + 1, 1)
    assert opened.sign_list(NOW).number == (NOW + 1, 2)


def test_the_list_is_kept_young_while_the_key_is_at_hand(opened: SigningAuthority) -> None:
    seq = opened.sign_list(NOW).seq
    csr = request()
    opened.issue(csr, NOW + 6 * DAY)
    assert opened.store.next_number() == (1, seq + 1)
    opened.issue(csr, NOW + 8 * DAY)
    assert opened.store.next_number() == (1, seq + 2)


def test_a_list_that_was_not_signed_for_a_revocation_is_signed_next(opened: SigningAuthority) -> None:
    opened.store.revoke(b"d" * 32, "then it was killed", NOW)
    with pytest.raises(ConfigurationError, match="no valid identity") as caught:
        opened.revoke_identity("/robot7", "again", NOW)
    assert "rossec ca publish" in caught.value.hint
    assert b"d" * 32 in listed_entries(opened)


def test_the_authoritys_own_node_and_one_of_many_are_not_revoked(opened: SigningAuthority) -> None:
    with pytest.raises(ConfigurationError, match="the authority's own node"):
        opened.revoke_identity(OWN_NODE, "", NOW)
    opened.issue(request("/rviz"), NOW, wildcard=True)
    with pytest.raises(ConfigurationError, match="no valid identity") as caught:
        opened.revoke_identity("/rviz_1", "", NOW)
    assert "one of the anonymous nodes of /rviz" in caught.value.hint


def test_a_grant_is_recorded_unless_its_key_was_revoked(opened: SigningAuthority) -> None:
    data = opened.issue_grant(draft(), NOW)
    assert [row.id for row in opened.store.grants()] == [document.grant_id(data)]
    opened.revoke(b"h" * 32, "lost", NOW)
    with pytest.raises(StoreError, match="is revoked"):
        opened.issue_grant(draft(b"h" * 32), NOW)


def test_a_revoked_grant_leaves_the_list_when_nothing_can_bring_it_back(opened: SigningAuthority) -> None:
    entry = document.grant_id(opened.issue_grant(draft(), NOW))
    opened.revoke(bytes(32), "", NOW)
    assert opened.revoke(entry, "", NOW).entries == {entry, bytes(32)}
    assert entry in opened.sign_list(NOW + 1000).entries
    assert opened.sign_list(NOW + 1061).entries == {bytes(32)}
    assert entry in opened.store.revoked_entries()


def test_a_delegation_is_recorded_until_it_is_revoked(opened: SigningAuthority) -> None:
    with pytest.raises(ConfigurationError, match="no delegation is in force"):
        opened.revoke_delegations("", NOW)
    living, expired = (
        open_delegation(opened.issue_delegation(bytes(32), days * DAY, 60, NOW), opened.signer.public_key)
        for days in (2, 1)
    )
    listed, count = opened.revoke_delegations("", NOW + DAY)
    assert (listed.entries, count) == (frozenset({living.id}), 1)
    assert expired.id not in listed.entries
    with pytest.raises(ConfigurationError):
        opened.revoke_delegations("", NOW + DAY)


def test_too_many_revocations_become_a_tree(
    opened: SigningAuthority, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(signing, "MAX_ENTRIES", 1)
    assert not is_tree(signed(opened.revoke(bytes(32), "", NOW), opened))
    listed = opened.revoke(bytes(16), "", NOW)
    tree = open_tree(signed(listed, opened), opened.signer.public_key)
    assert (tree.number, tree.size) == (listed.number, 2)


def signed(listed: RevocationList, opened: SigningAuthority) -> bytes:
    """The statement that was signed with the number of `listed`."""
    data = newest(opened)
    assert open_statement(data, opened.signer.public_key).number == listed.number
    return data


def test_an_intermediate_signs_identities_alone(site: Site) -> None:
    _, host = below(site, may_enroll=True)
    csr = request("/new")
    leaf, second, root = from_pem(host.issue(csr, NOW))
    assert site.anchor.verify([leaf, second], NOW).name == "/new"
    assert root == site.anchor.certificate
    for attempt in (
        lambda: host.sign_list(NOW),
        lambda: host.revoke(b"k" * 32, "", NOW),
        lambda: host.revoke_identity("/new", "", NOW),
        lambda: host.issue(csr, NOW, replace_key="/new"),
    ):
        with pytest.raises(ConfigurationError, match="an intermediate cannot revoke"):
            attempt()
    with pytest.raises(ConfigurationError, match="an intermediate cannot sign grants"):
        host.issue_grant(draft(), NOW)
    assert host.store.revoked_entries() == frozenset()


def test_grants_are_recorded_all_or_none(site: Site, opened: SigningAuthority) -> None:
    site.enroll("/robot")
    site.enroll("/viewer")
    holders = [site.identity(name).thumbprint for name in ("/robot", "/viewer")]
    drafts = [(draft(holder), "a b") for holder in holders]

    def refuse() -> None:
        raise StoreError("changed meanwhile")

    with pytest.raises(StoreError, match="changed meanwhile"):
        opened.issue_grants(drafts, NOW, refuse)
    assert opened.store.grants() == []
    assert len(opened.issue_grants(drafts, NOW)) == 2
    assert set(opened.store.policy_grants().values()) == {"a b"}
    opened.revoke(holders[1], "lost", NOW)
    with pytest.raises(StoreError):
        opened.issue_grants(drafts, NOW)
    assert len(opened.store.grants()) == 2


def test_many_revocations_are_one_list(opened: SigningAuthority) -> None:
    gone = frozenset({b"a" * 16, b"b" * 16})
    before = opened.store.next_number()
    assert opened.revoke_all(gone, "policy", NOW).entries >= gone
    assert opened.store.next_number() == (before[0], before[1] + 1)


def test_a_delegation_with_a_given_serial_is_the_same_when_it_is_signed_again(
    opened: SigningAuthority,
) -> None:
    key = opened.signer.public_key
    first, again = (
        open_delegation(opened.issue_delegation(bytes(32), DAY, 600, NOW, serial=b"s" * 16), key)
        for _ in range(2)
    )
    assert first.id == again.id
    assert len(signing.delegations(opened.path, key)) == 1
    other = open_delegation(opened.issue_delegation(bytes(32), DAY, 600, NOW), key)
    assert other.id != first.id
