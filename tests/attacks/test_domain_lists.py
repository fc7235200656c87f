"""Who tries to be trusted as another domain: by a bundle, an old list, a label that was left."""

import dataclasses
from pathlib import Path

import pytest

from ca.domains import TRUST_BUNDLE, Anchors, open_bundle, sign_domains
from ca.enrollment.qr import bundle_code, check_code
from ca.errors import BundleRefused, DomainsRefused, LogDamaged, StoreError
from ca.keys.signing import KeySigner
from ca.store.record import Store
from grants.model import Draft, Permission, Right
from rossec.authority.home import AuthorityHome
from rossec.authority.service import AuthorityService
from rossec.errors import ConfigurationError
from tests.support.commands import PASSPHRASE
from tests.support.domains import domains, foreign
from tests.support.pki import DAY, NOW, Site


def bundle_of(site: Site, signer: Site | None = None) -> bytes:
    """A bundle for the root of `site`, by the key of `signer`, whatever a bundle should be."""
    return TRUST_BUNDLE.sign(
        KeySigner((signer or site).key), {4: NOW + 7 * DAY, 6: NOW, -70037: site.root, -70038: ["/**"]}
    )


@pytest.mark.attack("foreign-bundle")
def test_a_bundle_that_another_has_made_or_changed() -> None:
    hospital, mallory = Site.create("hospital"), Site.create("hospital")
    genuine = bundle_of(hospital)
    with pytest.raises(BundleRefused, match="does not verify"):
        open_bundle(bundle_of(hospital, mallory), NOW)
    swapped = bundle_of(mallory)
    with pytest.raises(BundleRefused, match="does not fit the code"):
        check_code(bundle_code(genuine), swapped)
    assert open_bundle(swapped, NOW).anchor.thumbprint != open_bundle(genuine, NOW).anchor.thumbprint
    with pytest.raises(BundleRefused, match="expired"):
        open_bundle(genuine, NOW + 7 * DAY)
    for wide in (["/**"] * 17, [], ["/a*"]):
        with pytest.raises(BundleRefused):
            open_bundle(
                TRUST_BUNDLE.sign(
                    KeySigner(hospital.key), {4: NOW + DAY, 6: NOW, -70037: hospital.root, -70038: [*wide]}
                ),
                NOW,
            )


@pytest.mark.attack("old-domains")
def test_an_old_list_does_not_bring_a_removed_domain_back(tmp_path: Path) -> None:
    home, hospital, mallory = (Site.create(name) for name in ("home", "hospital", "home"))
    anchors, kept = Anchors(home.anchor), list[bytes]()
    old, new = domains(home, foreign(hospital)), domains(home, seq=2)
    anchors.update(old, kept.append)
    assert anchors.update(new, kept.append) == {"hospital"}
    restarted = Anchors(home.anchor)
    restarted.update(kept[-1])
    for verifier in (anchors, restarted):
        for data in (old, domains(home, foreign(hospital), seq=2)):
            with pytest.raises(DomainsRefused):
                verifier.update(data, kept.append)
        with pytest.raises(DomainsRefused):
            verifier.update(domains(mallory, foreign(hospital), seq=9))
        assert verifier.all_listed == ()
    assert kept == [old, new]


@pytest.fixture
def office(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AuthorityService:
    monkeypatch.setattr("ca.keys.passphrases._N", 16)  # the passphrase is not under test
    AuthorityHome.create(tmp_path / "home", "home", PASSPHRASE, NOW)
    return AuthorityService(tmp_path / "home", lambda: PASSPHRASE, lambda _: 1, lambda: NOW)


@pytest.mark.attack("taken-label")
def test_another_domain_does_not_get_the_name_label_or_key_of_one(office: AuthorityService) -> None:
    hospital = foreign(Site.create("hospital"))
    office.domains.accept(hospital)
    again = foreign(Site.create("hospital"))  # who calls itself so too
    for other in (again, foreign(Site.create("cafe"), "hospital")):
        with pytest.raises(StoreError):
            office.domains.accept(other)
    own = dataclasses.replace(again, domain="home", root=office.home.anchor().certificate, label="here")
    with pytest.raises(DomainsRefused):
        office.domains.accept(own)
    assert [row.read() for row in office.unlock().store.domains.accepted()] == [hospital]


@pytest.mark.attack("taken-label")
def test_a_label_is_no_way_to_the_grants_of_who_had_it(office: AuthorityService) -> None:
    hospital = foreign(Site.create("hospital"))
    office.domains.accept(hospital)
    authority = office.unlock()
    draft = Draft(
        "home",
        "/remote/hospital/rounds/a",
        b"k" * 32,
        NOW,
        NOW + DAY,
        NOW + DAY,
        b"s" * 16,
        (Permission("/door", Right.CALL),),
    )
    authority.issue_grant(draft, NOW)
    office.domains.remove("hospital", "", revoke_grants=False)
    for other in (foreign(Site.create("cafe"), "hospital"), foreign(Site.create("hospital"))):
        with pytest.raises(ConfigurationError, match="a grant names hospital"):
            office.domains.accept(other)
    assert authority.store.domains.accepted() == []


@pytest.mark.attack("rewritten-record")
def test_a_domain_that_was_written_into_the_record_is_found(office: AuthorityService, tmp_path: Path) -> None:
    """By who can write the record and its log, but has not the key."""
    hospital = foreign(Site.create("hospital"))
    office.domains.accept(hospital)
    office.domains.remove("hospital", "", revoke_grants=False)
    held = office.home.domain_list()
    assert held is not None
    mallory = KeySigner(Site.create("home").key)
    forged = sign_domains(mallory, dataclasses.replace(held[1], seq=9, domains=(hospital,)), "home")
    store = Store.open(tmp_path / "home" / "ca" / "ca.db")
    store.domains.accept(hospital, NOW)
    store.domains.save_list((1, 9), forged, NOW)
    with pytest.raises(LogDamaged, match="not a list of domains of this authority"):
        store.log.audit(office.home.own_key())
    with pytest.raises((DomainsRefused, ConfigurationError)):
        office.publish_domains()
    store.close()
