import secrets
from pathlib import Path

import pytest

from ca.authority import Authority
from ca.certificates import build_intermediate_request, from_pem, sign_renewal, to_pem
from ca.errors import CAError, Revoked, StoreError
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from ca.store.record import Store
from ca.svid import build_request, check_request
from rossec.authority.home import OWN_LIFETIME, AuthorityHome
from rossec.authority.renewals import (
    INTERMEDIATE_LIFETIME,
    import_identity,
    own_node_is_due,
    renew,
    renew_by_name,
    renew_own_node,
    renew_recorded,
    sign_intermediate,
)
from rossec.authority.signing import OWN_NODE, SigningAuthority
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from tests.support import refusal_texts
from tests.support.site import Site

NOW, DAY = 1_800_000_000, 86_400
LATER = NOW + 15 * DAY
LIFE = 20 * DAY


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site", clock=lambda: NOW)


def asks(home: NodeHome, key: KeySigner, now: int = LATER) -> bytes:
    """The renewal of a node, for `key`."""
    old = home.credentials()
    return sign_renewal(old.signer, old.chain, build_request(key, "home", home.name), now)


def below(site: Site, *, may_enroll: bool = False) -> tuple[str, SigningAuthority]:
    """An intermediate of the site, with a record of its own."""
    signer = KeySigner(generate())
    request = build_intermediate_request(signer, "home")
    name, bundle = sign_intermediate(site.authority, request, NOW, may_enroll=may_enroll)
    der, root = from_pem(bundle)
    path = site.root / f"below{may_enroll}"
    path.mkdir()
    host = SigningAuthority(Authority(signer, root, der), Store.create(path / "ca.db"), path)
    return name, host


def test_a_node_renews_itself(site: Site) -> None:
    home = site.enroll("/robot", LIFE)
    key = KeySigner(home.credentials().signer._key)  # type: ignore[attr-defined]
    bundle = renew(site.authority, asks(home, key), LATER)
    assert home.install(bundle, LATER).not_after == LATER + LIFE
    assert len(site.authority.store.identities.by_name("/robot")) == 2


def test_a_revoked_key_gets_no_successor(site: Site) -> None:
    """Also where the check that was passed in knows nothing of it."""
    home = site.enroll("/robot", LIFE)
    site.authority.store.revoke(home.identity(LATER).thumbprint, "stolen", LATER)
    asked = asks(home, KeySigner(generate()))
    with pytest.raises(Revoked):
        renew(site.authority, asked, LATER)
    with pytest.raises(StoreError, match="the key of /robot is revoked"):
        renew(site.authority, asked, LATER, lambda _entry, _now: None)


def test_one_renewal_one_answer(site: Site) -> None:
    home, key = site.enroll("/robot", LIFE), KeySigner(generate())
    asked = asks(home, key)
    first = renew(site.authority, asked, LATER)
    assert renew(site.authority, asked, LATER + 100) == first
    assert len(site.authority.store.identities.by_name("/robot")) == 2
    site.authority.revoke(
        check_request(build_request(key, "home", "/robot"), "home").thumbprint, "lost", LATER
    )
    with pytest.raises(StoreError, match="that identity is invalid or differs"):
        renew(site.authority, asked, LATER + 100)


def test_a_copy_of_the_node_cannot_renew_once_more(site: Site) -> None:
    home = site.enroll("/robot", LIFE)
    renew(site.authority, asks(home, KeySigner(generate())), LATER)
    with pytest.raises(CAError, match="/robot was renewed already, by another key") as no:
        renew(site.authority, asks(home, KeySigner(generate())), LATER)
    assert "revoke the name" in no.value.hint


def test_a_revoked_node_is_not_renewed(site: Site) -> None:
    home = site.enroll("/robot", LIFE)
    site.authority.revoke(site.identity("/robot").thumbprint, "lost", NOW)
    with pytest.raises(Revoked):
        renew(site.authority, asks(home, KeySigner(generate())), LATER)


def test_an_intermediate_renews_whom_it_never_saw(site: Site) -> None:
    home = site.enroll("/robot", LIFE)
    _, host = below(site)
    key = generate()
    bundle = renew(host, asks(home, KeySigner(key)), LATER, lambda *_: None)
    leaf, second, root = from_pem(bundle)
    identity = site.anchor.verify([leaf, second], LATER)
    assert identity.issuers == (host.authority.issuer.thumbprint,)
    assert (root, identity.public_key) == (site.anchor.certificate, key.public_key())
    assert host.verify(leaf, LATER) == identity


def test_an_intermediate_is_recorded_and_revoked_by_name(site: Site) -> None:
    name, host = below(site)
    assert site.authority.store.valid_certificate(name, NOW).not_after == NOW + INTERMEDIATE_LIFETIME
    listed, count = site.authority.revoke_identity(name, "stolen", NOW)
    assert (set(listed.entries), count) == ({host.authority.issuer.thumbprint}, 1)
    site.authority.store.log.audit(site.authority.signer.public_key)


def test_an_operator_renews_by_name(site: Site) -> None:
    home = site.enroll("/robot", LIFE)
    before = home.identity(NOW)
    after = home.install(renew_by_name(site.authority, "/robot", NOW + DAY), NOW + DAY)
    assert (after.thumbprint, after.not_after) == (before.thumbprint, NOW + 31 * DAY)
    with pytest.raises(StoreError, match="/nobody has no valid identity"):
        renew_by_name(site.authority, "/nobody", NOW)


def test_the_record_decides_what_the_service_renews(site: Site) -> None:
    home = site.enroll("/robot", 90 * DAY)
    later = NOW + 60 * DAY
    key = KeySigner(home.credentials().signer._key)  # type: ignore[attr-defined]
    bundle = renew_recorded(site.authority, asks(home, key, later), later)
    after = home.install(bundle, later)
    assert after.not_after == later + 90 * DAY, "as long as the one before"
    again = asks(home, key, later)
    with pytest.raises(CAError, match="is not due"):
        renew_recorded(site.authority, again, later)


def test_one_key_has_one_certificate_until_that_is_due(site: Site) -> None:
    """The old certificate is valid for long, and could ask without end."""
    home = site.enroll("/robot", LIFE)
    key = KeySigner(home.credentials().signer._key)  # type: ignore[attr-defined]
    bundles = {renew(site.authority, asks(home, key), LATER + day * 100) for day in range(3)}
    assert len(bundles) == 1
    assert len(site.authority.store.identities.by_name("/robot")) == 2


def test_what_an_intermediate_signed_is_renewed_by_the_root_itself(site: Site) -> None:
    _, host = below(site, may_enroll=True)
    home = NodeHome.of(site.root, "/elsewhere")
    home.create_request("home")
    home.install(host.issue(home.request(), NOW, LIFE), NOW)
    key = KeySigner(home.credentials().signer._key)  # type: ignore[attr-defined]
    with pytest.raises(CAError, match="is not in the authority's record") as caught:
        renew_recorded(site.authority, asks(home, key), LATER)
    assert "rossec ca import NODE.pem" in caught.value.hint
    import_identity(site.authority, home._read("node.pem", ""), LATER)
    assert len(from_pem(renew_recorded(site.authority, asks(home, key), LATER))) == 2


def test_one_that_is_over_comes_back_with_its_key(site: Site) -> None:
    home = site.enroll("/robot", LIFE)
    before, late = home.identity(NOW), NOW + LIFE + DAY
    with pytest.raises(StoreError, match="the identity of /robot ended on"):
        renew_by_name(site.authority, "/robot", late)
    after = home.install(renew_by_name(site.authority, "/robot", late, expired=True), late)
    assert after.thumbprint == before.thumbprint
    assert after.not_after == late + 30 * DAY


def test_below_a_revoked_intermediate_nothing_comes_back(site: Site) -> None:
    name, host = below(site, may_enroll=True)
    import_identity(site.authority, imported(host), NOW)
    site.authority.revoke_identity(name, "stolen", NOW)
    with pytest.raises(StoreError, match="the intermediate that signed the identity"):
        renew_by_name(site.authority, "/elsewhere", NOW + 60 * DAY, expired=True)


def test_an_operator_renews_below_what_the_root_signed(site: Site) -> None:
    home = site.enroll("/robot", LIFE)
    _, host = below(site)
    renew(host, asks(home, KeySigner(generate())), LATER, lambda *_: None)
    again = renew_by_name(host, "/robot", LATER)
    assert len(from_pem(again)) == 3
    assert host.verify(from_pem(home._read("node.pem", ""))[0], NOW).issuers == ()


def test_the_authoritys_own_node(tmp_path: Path) -> None:
    passphrase = "four random words here"
    home = AuthorityHome.create(tmp_path, "home", passphrase, NOW)
    authority = home.unlock(passphrase)
    assert not own_node_is_due(authority, NOW + OWN_LIFETIME // 2)
    late = NOW + OWN_LIFETIME + DAY  # expired, while nobody looked
    assert own_node_is_due(authority, late)
    assert renew_own_node(authority, late) == late + OWN_LIFETIME
    assert home.node().identity(late).name == OWN_NODE
    assert not own_node_is_due(authority, late)


def test_an_intermediates_host_has_no_such_node(site: Site) -> None:
    assert not own_node_is_due(below(site)[1], NOW + 1000 * DAY)


def test_bundles_with_an_intermediate_install(site: Site) -> None:
    home = site.enroll("/robot", LIFE)
    _, host = below(site)
    der = host.authority.reissue(
        site.identity("/robot"), site.identity("/robot").public_key, now=NOW, serial=secrets.randbits(127)
    )
    home.install(host.bundle(der), NOW)
    assert home.credentials().chain == (der, *host.authority.chain)
    assert home.identity(NOW).issuers == (host.authority.issuer.thumbprint,)
    assert not home.is_wildcard()
    other, _ = NodeHome.for_bundle(site.root, host.bundle(der), NOW)
    assert other.path == home.path
    with pytest.raises(ConfigurationError, match="a bundle of 4 certificates where two or three"):
        home.install(host.bundle(der) + to_pem(der), NOW)


def imported(host: SigningAuthority, name: str = "/elsewhere") -> bytes:
    """The bundle of a node that `host` enrolled."""
    return host.issue(build_request(KeySigner(generate()), "home", name), NOW)


def test_what_an_intermediate_enrolled_is_recorded_once(site: Site) -> None:
    _, host = below(site, may_enroll=True)
    bundle = imported(host)
    identity, new = import_identity(site.authority, bundle, NOW)
    assert (identity.name, new) == ("/elsewhere", True)
    assert import_identity(site.authority, bundle, NOW) == (identity, False)
    assert site.authority.store.valid_certificate("/elsewhere", NOW).serial == identity.serial
    leaf, root = from_pem(renew_by_name(site.authority, "/elsewhere", NOW))
    assert site.anchor.verify([leaf], NOW).public_key == identity.public_key
    assert root == site.anchor.certificate


def test_another_key_is_imported_only_by_name(site: Site) -> None:
    _, host = below(site, may_enroll=True)
    old = site.identity("/elsewhere").thumbprint
    bundle = imported(host)
    with pytest.raises(StoreError, match=refusal_texts.KEY_CHANGED):
        import_identity(site.authority, bundle, NOW)
    assert import_identity(site.authority, bundle, NOW, {"/elsewhere"})[1]
    assert old in site.authority.store.revoked_entries()


def test_what_cannot_be_imported(site: Site) -> None:
    name, host = below(site, may_enroll=True)
    with pytest.raises(ConfigurationError, match="/ca cannot be imported here"):
        import_identity(site.authority, imported(host, OWN_NODE), NOW)
    bundle = imported(host)
    with pytest.raises(ConfigurationError, match="/elsewhere cannot be imported here"):
        import_identity(host, bundle, NOW)
    site.authority.revoke_identity(name, "stolen", NOW)
    with pytest.raises(StoreError, match="the intermediate of /elsewhere is revoked"):
        import_identity(site.authority, bundle, NOW)


def test_an_intermediate_that_is_not_in_the_record_vouches_for_nobody(site: Site, tmp_path: Path) -> None:
    _, host = below(site, may_enroll=True)
    path = tmp_path / "older"
    path.mkdir()
    older = SigningAuthority(site.authority.authority, Store.create(path / "ca.db"), path)
    with pytest.raises(StoreError, match="is not in this record"):
        import_identity(older, imported(host), NOW)
