import dataclasses
import secrets
import subprocess
from datetime import UTC, datetime
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.x509 import verification

from ca.authority import LIFETIME, MAX_LIFETIME, ROOT_LIFETIME, Authority, create_root
from ca.certificates import TrustAnchor, build_intermediate_request, open_renewal, sign_renewal, to_pem
from ca.errors import CAError, CertificateRefused, KeyRefused, NameRefused, RequestRefused
from ca.keys.signing import KeySigner
from ca.svid import build_request
from tests.support.pki import DAY, NOW, Site, new_signer

SITE = Site.create()
CSR = build_request(new_signer(), "home", "/robot1/camera")
SEASON, HOST = 90 * DAY, new_signer()


def issue(now: int = NOW, serial: int = 5, lifetime: int = LIFETIME) -> x509.Certificate:
    return x509.load_der_x509_certificate(
        SITE.authority.issue(CSR, now=now, serial=serial, lifetime=lifetime)
    )


def seconds(moment: datetime) -> int:
    return int(moment.timestamp())


def test_an_authority_issues_what_the_request_shows() -> None:
    signer = new_signer()
    csr = build_request(signer, "home", "/master")
    serial = secrets.randbits(128) | 1
    identity = SITE.anchor.verify([SITE.authority.issue(csr, now=NOW, serial=serial)], NOW)
    assert (identity.name, identity.serial) == ("/master", serial)
    assert identity.public_key == signer.public_key


def test_a_certificate_lasts_thirty_days_from_an_hour_ago() -> None:
    certificate = issue(now=NOW + DAY)
    assert seconds(certificate.not_valid_before_utc) == NOW + DAY - 3600
    assert seconds(certificate.not_valid_after_utc) == NOW + DAY + 30 * DAY


def test_a_certificate_never_begins_before_the_authority() -> None:
    assert seconds(issue(now=NOW - 1800).not_valid_before_utc) == NOW - 3600


def test_a_certificate_never_outlives_the_authority() -> None:
    end = NOW + ROOT_LIFETIME
    assert seconds(issue(now=end - DAY).not_valid_after_utc) == end


@pytest.mark.parametrize("now", [NOW - 3601, NOW + ROOT_LIFETIME + 1])
def test_an_expired_authority_issues_nothing(now: int) -> None:
    with pytest.raises(CAError, match="own certificate is not valid now") as caught:
        issue(now=now)
    assert "clock" in caught.value.hint


@pytest.mark.parametrize("lifetime", [0, -1, MAX_LIFETIME + 1])
def test_lifetimes_out_of_range(lifetime: int) -> None:
    with pytest.raises(CAError, match=f"a lifetime of {lifetime} s where 1 to"):
        issue(lifetime=lifetime)


@pytest.mark.parametrize("lifetime", [1, MAX_LIFETIME])
def test_lifetimes_at_the_border(lifetime: int) -> None:
    assert seconds(issue(lifetime=lifetime).not_valid_after_utc) == NOW + lifetime


@pytest.mark.parametrize("serial", [0, -1, 1 << 128])
def test_serials_out_of_range(serial: int) -> None:
    with pytest.raises(CAError, match="a serial is a positive number of 128 bits"):
        issue(serial=serial)
    with pytest.raises(CAError, match="a serial is a positive number of 128 bits"):
        create_root(new_signer(), "home", now=NOW, serial=serial)


@pytest.mark.parametrize("serial", [1, (1 << 128) - 1])
def test_serials_at_the_border(serial: int) -> None:
    assert issue(serial=serial).serial_number == serial


def test_requests_are_checked() -> None:
    with pytest.raises(RequestRefused, match="trust domain 'lab', this authority is 'home'"):
        SITE.authority.issue(build_request(new_signer(), "lab", "/a"), now=NOW, serial=5)


def test_key_and_certificate_must_fit() -> None:
    with pytest.raises(CAError, match="belongs to another key") as caught:
        Authority(new_signer(), SITE.root)
    assert "same backup" in caught.value.hint
    with pytest.raises(CertificateRefused):
        Authority(new_signer(), SITE.leaf())


def test_no_root_without_a_domain() -> None:
    with pytest.raises(NameRefused, match="'Home' is not a trust domain"):
        create_root(new_signer(), "Home", now=NOW, serial=1)


def test_roots_of_one_domain_have_different_subjects() -> None:
    first, second = (TrustAnchor.load(create_root(new_signer(), "home", now=NOW, serial=1)) for _ in "ab")
    assert first.subject != second.subject
    assert first.not_after - first.not_before == 3650 * DAY + 3600


def test_openssl_accepts_it_strictly(tmp_path: Path) -> None:
    (tmp_path / "ca.pem").write_bytes(to_pem(SITE.root))
    longest = build_request(new_signer(), "home", "/" + "a" * 254)
    for number, csr in enumerate((CSR, longest, CSR)):
        leaf = tmp_path / f"{number}.pem"
        der = SITE.authority.issue(csr, now=NOW, serial=5, wildcard=number == 2)
        leaf.write_bytes(to_pem(der))
        command = ["openssl", "verify", "-x509_strict", "-check_ss_sig", "-policy_check"]
        arguments = ["-attime", str(NOW), "-CAfile", str(tmp_path / "ca.pem"), str(leaf)]
        done = subprocess.run([*command, *arguments], capture_output=True, check=False, text=True)
        assert done.stdout.strip().endswith("OK"), done.stderr


@pytest.mark.parametrize("wildcard", [False, True])
def test_the_verifier_of_cryptography_accepts_it(*, wildcard: bool) -> None:
    root = x509.load_der_x509_certificate(SITE.root)
    verifier = (
        verification.PolicyBuilder()
        .store(verification.Store([root]))
        .time(datetime.fromtimestamp(NOW, UTC))
        .build_client_verifier()
    )
    der = SITE.authority.issue(CSR, now=NOW, serial=5, wildcard=wildcard)
    verified = verifier.verify(x509.load_der_x509_certificate(der), [])
    assert verified.subjects is not None
    assert [name.value for name in verified.subjects] == ["spiffe://home/robot1/camera"]


def test_an_authority_has_a_p256_key() -> None:
    from cryptography.hazmat.primitives.asymmetric import ec

    from ca.keys.signing import KeySigner

    signer = KeySigner(ec.generate_private_key(ec.SECP384R1()))
    with pytest.raises(KeyRefused):
        create_root(signer, "home", now=NOW, serial=1)


def test_a_wildcard_tail_on_the_approvers_word_alone() -> None:
    asking = build_request(new_signer(), "home", "/rviz", wildcard=True)
    with pytest.raises(RequestRefused, match="all names that begin with /rviz_"):
        SITE.authority.issue(asking, now=NOW, serial=5)
    for csr in (asking, CSR):
        der = SITE.authority.issue(csr, now=NOW, serial=5, wildcard=True)
        assert SITE.anchor.verify([der], NOW).wildcard
    assert not SITE.anchor.verify([SITE.authority.issue(CSR, now=NOW, serial=5)], NOW).wildcard


@pytest.mark.parametrize("name", ["/master", "/ca"])
def test_no_wildcard_tail_for_those_whom_all_trust(name: str) -> None:
    csr = build_request(new_signer(), "home", name)
    with pytest.raises(NameRefused, match=f"{name} is a single node"):
        SITE.authority.issue(csr, now=NOW, serial=5, wildcard=True)


def intermediate(*, may_enroll: bool = True) -> bytes:
    request = build_intermediate_request(HOST, "home")
    return SITE.authority.issue_intermediate(
        request, now=NOW, serial=7, may_enroll=may_enroll, lifetime=SEASON
    )


def test_an_intermediate_enrolls_only_where_it_may() -> None:
    below = Authority(HOST, SITE.root, intermediate())
    may_renew = Authority(HOST, SITE.root, intermediate(may_enroll=False))
    assert (below.may_enroll, may_renew.may_enroll) == (True, False)
    assert (SITE.authority.is_root, below.is_root) == (True, False)
    assert SITE.anchor.verify([below.issue(CSR, now=NOW, serial=4), *below.chain], NOW).serial == 4
    with pytest.raises(CAError, match="may renew identities, not enroll nodes"):
        may_renew.issue(CSR, now=NOW, serial=4)


def test_an_identity_is_reissued_for_another_key_at_an_intermediate_too() -> None:
    may_renew = Authority(HOST, SITE.root, intermediate(may_enroll=False))
    known, key = SITE.anchor.verify([SITE.leaf()], NOW), new_signer().public_key
    der = may_renew.reissue(known, key, now=NOW, serial=9, lifetime=DAY)
    again = SITE.anchor.verify([der, *may_renew.chain], NOW)
    assert (again.name, again.public_key) == (known.name, key)


def test_a_renewal_lasts_no_longer_than_what_it_renews() -> None:
    signer, new, due = new_signer(), new_signer(), NOW + DAY * 3 // 4
    old = SITE.authority.issue(build_request(signer, "home", "/a"), now=NOW, serial=3, lifetime=DAY)
    text = sign_renewal(signer, (old,), build_request(new, "home", "/a"), due)
    renewal = open_renewal(text, SITE.anchor, due, lambda _key, _now: None)
    der = SITE.authority.renew(renewal, now=due, serial=4)
    certificate = x509.load_der_x509_certificate(der)
    assert seconds(certificate.not_valid_after_utc) == due + DAY


def test_only_a_root_with_room_makes_intermediates() -> None:
    request = build_intermediate_request(HOST, "home")
    older = Authority(KeySigner(SITE.key), SITE.root)
    older.anchor = dataclasses.replace(SITE.anchor, path_length=0)
    older.issuer = older.anchor
    for authority in (Authority(HOST, SITE.root, intermediate()), older):
        with pytest.raises(CAError, match="this authority may have no intermediates"):
            authority.issue_intermediate(request, now=NOW, serial=4, may_enroll=True, lifetime=SEASON)


def test_an_intermediate_needs_its_own_key_and_time() -> None:
    with pytest.raises(CAError, match="belongs to another key"):
        Authority(new_signer(), SITE.root, intermediate())
    with pytest.raises(CAError, match="own certificate is not valid now"):
        Authority(HOST, SITE.root, intermediate()).issue(CSR, now=NOW + SEASON + 1, serial=4)


def test_a_node_cannot_become_an_intermediate_by_a_nodes_request() -> None:
    with pytest.raises(RequestRefused):
        SITE.authority.issue(build_intermediate_request(HOST, "home"), now=NOW, serial=4)
