"""A second certificate in the chain: what makes it an intermediate, and each way it is none."""

import dataclasses
import secrets
import subprocess
from datetime import UTC, datetime
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509 import verification

from ca.authority import Authority
from ca.certificates import (
    MAY_ENROLL,
    MAY_RENEW,
    build_intermediate_request,
    check_intermediate_request,
    policy,
    to_pem,
)
from ca.errors import (
    CertificateExpired,
    CertificateNotYetValid,
    CertificateRefused,
    ForeignCertificate,
    NameRefused,
    RequestRefused,
)
from ca.keys.signing import KeySigner
from ca.svid import build_request
from tests.support.pki import (
    DAY,
    NOW,
    Draft,
    Extensions,
    Site,
    draft_leaf,
    leaf_extensions,
    new_signer,
    uris,
    usage,
)

SITE, SEASON = Site.create(), 90 * DAY
HOST = KeySigner(ec.generate_private_key(ec.SECP256R1()))


def intermediate(*, may_enroll: bool = True, now: int = NOW, site: Site = SITE) -> bytes:
    request = build_intermediate_request(HOST, site.anchor.domain)
    return site.authority.issue_intermediate(
        request, now=now, serial=secrets.randbits(127), may_enroll=may_enroll, lifetime=SEASON
    )


DER = intermediate()
BELOW = Authority(HOST, SITE.root, DER)


def leaf(name: str = "/robot1/camera", now: int = NOW) -> bytes:
    return BELOW.issue(build_request(new_signer(), "home", name), now=now, serial=9)


LEAF = leaf()


def test_a_leaf_and_its_intermediate() -> None:
    identity = SITE.anchor.verify([LEAF, DER], NOW)
    assert (identity.name, identity.certificate) == ("/robot1/camera", LEAF)
    assert identity.issuers == (BELOW.issuer.thumbprint,)
    assert identity.keys == (identity.thumbprint, BELOW.issuer.thumbprint)
    assert SITE.anchor.verify([SITE.leaf()], NOW).issuers == ()


def test_the_chain_ends_with_its_first_end() -> None:
    late = NOW + SEASON - DAY
    identity = SITE.anchor.verify([leaf(now=late), DER], late)
    assert identity.not_after == NOW + SEASON
    with pytest.raises(CertificateExpired, match="the intermediate's certificate expired 1 s ago"):
        SITE.anchor.verify([LEAF, DER], NOW + SEASON + 1)
    early = intermediate(now=NOW + 2 * DAY)
    with pytest.raises(CertificateNotYetValid, match="the intermediate's certificate becomes"):
        SITE.anchor.verify([LEAF, early], NOW)


def test_without_its_intermediate_a_leaf_is_a_strangers() -> None:
    with pytest.raises(ForeignCertificate, match="the certificate is not signed by"):
        SITE.anchor.verify([LEAF], NOW)


def test_order_and_membership_count() -> None:
    with pytest.raises(CertificateRefused):
        SITE.anchor.verify([DER, LEAF], NOW)
    with pytest.raises(ForeignCertificate, match="the certificate is not signed by"):
        SITE.anchor.verify([SITE.leaf(), DER], NOW)  # a leaf of the root, not of this one
    with pytest.raises(CertificateRefused, match="has no critical basic constraints with CA false"):
        SITE.anchor.verify([DER], NOW)  # an intermediate is no identity
    with pytest.raises(CertificateRefused, match="where one or two are expected"):
        SITE.anchor.verify([LEAF, DER, SITE.root], NOW)


def test_a_strangers_intermediate() -> None:
    other = intermediate(site=Site.create())
    with pytest.raises(ForeignCertificate, match="the intermediate is not signed by"):
        SITE.anchor.verify([LEAF, other], NOW)


def test_a_node_is_no_intermediate() -> None:
    """The classic: a leaf's key signs another leaf (CVE-2002-0862)."""
    key = ec.generate_private_key(ec.SECP256R1())
    node = SITE.authority.issue(build_request(KeySigner(key), "home", "/node"), now=NOW, serial=3)
    subject = x509.load_der_x509_certificate(node).subject
    forged = Draft(subject, key, leaf_extensions(), public_key=new_signer().public_key).build()
    with pytest.raises(CertificateRefused, match="this is not an authority's certificate"):
        SITE.anchor.verify([forged, node], NOW)


def draft(extensions: Extensions) -> bytes:
    return dataclasses.replace(
        draft_leaf(SITE, extensions), public_key=HOST.public_key, subject=BELOW.issuer.subject
    ).build()


CA, SIGN = (x509.BasicConstraints(ca=True, path_length=0), True), ("key_cert_sign", "crl_sign")
USAGE, HOME, ENROLL = (usage(*SIGN), True), (uris("spiffe://home"), False), policy(may_enroll=True)
BOTH = x509.CertificatePolicies(
    [x509.PolicyInformation(MAY_RENEW, None), x509.PolicyInformation(MAY_ENROLL, None)]
)


def test_the_draft_itself_is_good() -> None:
    SITE.anchor.verify([LEAF, draft([CA, USAGE, HOME, (ENROLL, False)])], NOW)


@pytest.mark.parametrize(
    ("extensions", "message"),
    [
        (
            [(x509.BasicConstraints(ca=True, path_length=1), True), USAGE, HOME, (ENROLL, False)],
            "the intermediate's path length is not 0",
        ),
        (
            [(x509.BasicConstraints(ca=True, path_length=None), True), USAGE, HOME],
            "the intermediate's path length is not 0",
        ),
        ([(CA[0], False), USAGE, HOME], "not an authority's certificate"),
        (
            [CA, (usage(*SIGN, "digital_signature"), True), HOME],
            "key usage is not certificate and CRL signing only",
        ),
        ([CA, (usage("digital_signature"), True), HOME], "may not sign certificates"),
        ([CA, USAGE, (uris("spiffe://lab"), False)], "for trust domain 'lab', not 'home'"),
        ([CA, USAGE, (uris("spiffe://home/a"), False)], "the authority's name is invalid"),
        ([CA, USAGE, (uris("https://home"), False)], "is not a SPIFFE trust domain"),
        ([CA, USAGE], "0 names where exactly one"),
        ([CA, USAGE, HOME], "has no policy to renew or enroll"),
        ([CA, USAGE, HOME, (BOTH, False)], "has no policy to renew or enroll"),
        ([CA, USAGE, HOME, (ENROLL, True)], "unknown critical extension"),
    ],
)
def test_a_certificate_that_is_not_an_intermediate(extensions: Extensions, message: str) -> None:
    with pytest.raises(CertificateRefused, match=message):
        SITE.anchor.verify([LEAF, draft(extensions)], NOW)


def test_a_root_without_room_below_it() -> None:
    older = dataclasses.replace(SITE.anchor, path_length=0)
    with pytest.raises(CertificateRefused, match="may have no intermediates"):
        older.verify([LEAF, DER], NOW)
    dataclasses.replace(SITE.anchor, path_length=None).verify([LEAF, DER], NOW)


def test_requests_for_one() -> None:
    request = build_intermediate_request(HOST, "home")
    assert check_intermediate_request(request, "home") == HOST.public_key
    with pytest.raises(RequestRefused, match="not a request for an intermediate of 'lab'"):
        check_intermediate_request(request, "lab")
    with pytest.raises(RequestRefused, match="not a request for an intermediate of 'home'"):
        check_intermediate_request(build_request(HOST, "home", "/a"), "home")
    with pytest.raises(NameRefused):
        build_intermediate_request(HOST, "Not a domain")
    with pytest.raises(RequestRefused, match="this is not a certificate request"):
        check_intermediate_request(b"nothing", "home")
    with pytest.raises(RequestRefused, match="a request of 2049 bytes"):
        check_intermediate_request(bytes(2049), "home")
    while request[-1] & 1:
        request = build_intermediate_request(HOST, "home")
    size = len(x509.load_der_x509_csr(request).signature)
    twisted = bytearray(request)
    twisted[-size - 1] = 1
    with pytest.raises(RequestRefused, match="signature is not in whole octets"):
        check_intermediate_request(bytes(twisted), "home")


def test_openssl_and_cryptography_accept_the_chain(tmp_path: Path) -> None:
    for name, certificate in (("ca", SITE.root), ("below", DER), ("leaf", LEAF)):
        (tmp_path / name).write_bytes(to_pem(certificate))
    command = ["openssl", "verify", "-x509_strict", "-check_ss_sig", "-policy_check"]
    chain = ["-CAfile", str(tmp_path / "ca"), "-untrusted", str(tmp_path / "below")]
    arguments = ["-attime", str(NOW), *chain, str(tmp_path / "leaf")]
    done = subprocess.run([*command, *arguments], capture_output=True, check=False, text=True)
    assert done.stdout.strip().endswith("OK"), done.stderr
    root, below, end = map(x509.load_der_x509_certificate, (SITE.root, DER, LEAF))
    verifier = verification.PolicyBuilder().store(verification.Store([root]))
    verified = verifier.time(datetime.fromtimestamp(NOW, UTC)).build_client_verifier()
    assert len(verified.verify(end, [below]).chain) == 3
