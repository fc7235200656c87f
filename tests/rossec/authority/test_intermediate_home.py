from pathlib import Path

import pytest

from ca.certificates import from_pem, to_pem
from ca.errors import CAError, CertificateNotYetValid
from rossec.authority import renewals
from rossec.authority.home import AuthorityHome
from rossec.authority.renewals import sign_intermediate
from rossec.errors import ConfigurationError
from tests.support.site import Site

NOW, DAY = 1_800_000_000, 86_400
PASSPHRASE = "four random words here"


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site", clock=lambda: NOW)


def signed(site: Site, request: Path, *, may_enroll: bool = True) -> bytes:
    return sign_intermediate(site.authority, request.read_bytes(), NOW, may_enroll=may_enroll)[1]


def test_an_intermediate_is_an_authority_once_the_root_has_signed(site: Site, tmp_path: Path) -> None:
    request = renewals.begin(tmp_path, "home", PASSPHRASE)
    with pytest.raises(ConfigurationError, match="there is no authority in"):
        AuthorityHome.at(tmp_path)
    installed = renewals.install(tmp_path, signed(site, request), PASSPHRASE, NOW)
    home = AuthorityHome.at(tmp_path)
    assert (home.is_intermediate, installed.may_enroll) == (True, True)
    assert home.own_key() == installed.public_key
    assert home.anchor() == site.anchor
    assert home.count_unlisted(NOW) == 0
    with pytest.raises(ConfigurationError, match="there is an authority in"):
        renewals.begin(tmp_path, "home", PASSPHRASE)


def test_a_newer_certificate_for_the_same_key_replaces_the_older(site: Site, tmp_path: Path) -> None:
    request = renewals.begin(tmp_path, "home", PASSPHRASE)
    for may_enroll in (True, False):
        bundle = signed(site, request, may_enroll=may_enroll)
        assert renewals.install(tmp_path, bundle, PASSPHRASE, NOW).may_enroll is may_enroll
    assert not AuthorityHome.at(tmp_path).unlock(PASSPHRASE).authority.may_enroll


def test_another_key_another_root_and_another_time_are_refused(site: Site, tmp_path: Path) -> None:
    request = renewals.begin(tmp_path, "home", PASSPHRASE)
    bundle = signed(site, request)
    elsewhere = renewals.begin(tmp_path / "host", "home", PASSPHRASE)
    with pytest.raises(CAError, match="belongs to another key"):
        renewals.install(tmp_path, signed(site, elsewhere), PASSPHRASE, NOW)
    with pytest.raises(CertificateNotYetValid):
        renewals.install(tmp_path, bundle, PASSPHRASE, NOW - DAY)
    renewals.install(tmp_path, bundle, PASSPHRASE, NOW)
    other = Site(tmp_path / "other", clock=lambda: NOW)
    with pytest.raises(ConfigurationError, match="the intermediate of another root"):
        renewals.install(tmp_path, signed(other, request), PASSPHRASE, NOW)
    assert AuthorityHome.at(tmp_path).anchor() == site.anchor


@pytest.mark.parametrize("count", [1, 3])
def test_a_bundle_has_two_certificates(site: Site, tmp_path: Path, count: int) -> None:
    request = renewals.begin(tmp_path, "home", PASSPHRASE)
    ders = [*from_pem(signed(site, request)), site.anchor.certificate][:count]
    with pytest.raises(ConfigurationError, match=f"a bundle of {count} certificates where two"):
        renewals.install(tmp_path, to_pem(*ders), PASSPHRASE, NOW)
    assert not (tmp_path / "ca" / "ca.pem").exists()
