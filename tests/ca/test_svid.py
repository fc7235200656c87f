"""One certificate, one flaw, one message: the functions are fed parsed certificates directly."""

import dataclasses
from unittest.mock import Mock, PropertyMock

import pytest
from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from cryptography.utils import CryptographyDeprecationWarning

from ca import svid
from ca.errors import CertificateRefused
from tests.support.pki import (
    NOW,
    Draft,
    Site,
    draft_leaf,
    draft_root,
    leaf_extensions,
    root_extensions,
    uris,
    usage,
)

SITE = Site.create()
NO_CA, USAGE, NAME = leaf_extensions()
UNKNOWN = x509.UnrecognizedExtension(x509.ObjectIdentifier("1.2.3.4"), b"\x05\x00")
MALFORMED = "this is not a well-formed certificate"


def extensions_of(draft: Draft) -> x509.Extensions:
    return svid.extensions(svid.parse(draft.build()))


def leaf_with(*extensions: tuple[x509.ExtensionType, bool]) -> x509.Extensions:
    return extensions_of(draft_leaf(SITE, extensions))


def test_a_good_leaf_passes() -> None:
    extensions = leaf_with(NO_CA, USAGE, NAME)
    svid.check_leaf(extensions)
    assert svid.only_uri(extensions) == "spiffe://home/robot1/camera"


def test_a_good_root_passes() -> None:
    svid.check_authority(extensions_of(draft_root()))


@pytest.mark.parametrize(
    "constraints",
    [
        [],
        [(x509.BasicConstraints(ca=True, path_length=None), True)],
        [(x509.BasicConstraints(ca=True, path_length=0), True)],
        [(x509.BasicConstraints(ca=False, path_length=None), False)],
    ],
)
def test_a_leaf_says_that_it_is_no_ca(constraints: list[tuple[x509.ExtensionType, bool]]) -> None:
    with pytest.raises(CertificateRefused, match="has no critical basic constraints with CA false"):
        svid.check_leaf(leaf_with(*constraints, USAGE, NAME))


@pytest.mark.parametrize(
    "usages",
    [
        [],
        [(usage("digital_signature"), False)],
        [(usage("digital_signature", "key_cert_sign"), True)],
        [(usage("digital_signature", "crl_sign"), True)],
        [(usage("digital_signature", "content_commitment"), True)],
        [(usage("digital_signature", "key_encipherment"), True)],
        [(usage("digital_signature", "data_encipherment"), True)],
        [(usage("digital_signature", "key_agreement"), True)],
        [(usage("digital_signature", "key_agreement", "encipher_only"), True)],
        [(usage("key_agreement"), True)],
    ],
)
def test_a_leaf_signs_and_nothing_else(usages: list[tuple[x509.ExtensionType, bool]]) -> None:
    with pytest.raises(CertificateRefused, match="key usage is not digital signature only"):
        svid.check_leaf(leaf_with(NO_CA, *usages, NAME))


@pytest.mark.parametrize(
    ("names", "count"),
    [
        ([], 0),
        ([(uris("spiffe://home/a", "spiffe://home/b"), True)], 2),
        ([(x509.SubjectAlternativeName([x509.DNSName("a")]), True)], 1),
        (
            [
                (
                    x509.SubjectAlternativeName(
                        [x509.UniformResourceIdentifier("spiffe://home/a"), x509.DNSName("a")]
                    ),
                    True,
                )
            ],
            2,
        ),
    ],
)
def test_exactly_one_uri(names: list[tuple[x509.ExtensionType, bool]], count: int) -> None:
    with pytest.raises(CertificateRefused, match=f"has {count} names where exactly one URI"):
        svid.only_uri(leaf_with(NO_CA, USAGE, *names))


def test_unknown_critical_extensions_are_refused() -> None:
    with pytest.raises(CertificateRefused, match=r"unknown critical extension 1\.2\.3\.4"):
        leaf_with(NO_CA, USAGE, NAME, (UNKNOWN, True))


def test_a_known_extension_made_critical_is_unknown_to_us() -> None:
    extended = x509.ExtendedKeyUsage([x509.oid.ExtendedKeyUsageOID.SERVER_AUTH])
    with pytest.raises(CertificateRefused, match="unknown critical extension"):
        leaf_with(NO_CA, USAGE, NAME, (extended, True))


def test_other_extensions_are_ignored() -> None:
    svid.check_leaf(leaf_with(NO_CA, USAGE, NAME, (UNKNOWN, False)))


def test_a_certificate_that_is_not_an_authority() -> None:
    with pytest.raises(CertificateRefused, match="this is not an authority's certificate"):
        svid.check_authority(leaf_with(NO_CA, USAGE, NAME))
    constraints, _, name = root_extensions()
    draft = draft_root([constraints, (usage("crl_sign"), True), name])
    with pytest.raises(CertificateRefused, match="may not sign certificates"):
        svid.check_authority(extensions_of(draft))


@pytest.mark.parametrize(
    "key",
    [ec.generate_private_key(ec.SECP384R1()).public_key(), ed25519.Ed25519PrivateKey.generate().public_key()],
)
def test_an_svid_has_a_p256_key(key: ec.EllipticCurvePublicKey | ed25519.Ed25519PublicKey) -> None:
    der = dataclasses.replace(draft_leaf(SITE), public_key=key).build()
    with pytest.raises(CertificateRefused, match="the certificate's key is not a P-256 key"):
        svid.key_of(svid.parse(der))


def test_the_signer_is_checked() -> None:
    leaf = svid.parse(draft_leaf(SITE).build())
    ours, other = SITE.anchor.public_key, Site.create().anchor
    assert svid.is_signed_by(leaf, SITE.anchor.subject, ours)
    assert not svid.is_signed_by(leaf, other.subject, ours)
    assert not svid.is_signed_by(leaf, SITE.anchor.subject, other.public_key)
    sha384 = dataclasses.replace(draft_leaf(SITE), algorithm=hashes.SHA384()).build()
    assert not svid.is_signed_by(svid.parse(sha384), SITE.anchor.subject, ours)


def test_the_subject() -> None:
    assert svid.subject(svid.parse(SITE.root)) == SITE.anchor.subject


def test_validity_is_in_seconds() -> None:
    assert svid.validity(svid.parse(draft_leaf(SITE).build())) == (NOW, NOW + 86_400)


def test_too_large_input_is_refused() -> None:
    with pytest.raises(CertificateRefused, match="a certificate of 2049 bytes where at most 2048"):
        svid.parse(bytes(2049))


def test_garbage_is_not_parsed_as_a_certificate() -> None:
    with pytest.raises(CertificateRefused, match=MALFORMED):
        svid.parse(b"garbage")


def test_serials_are_positive() -> None:
    der = bytearray(draft_leaf(SITE).build())
    der[der.index(b"\x02\x01\x07") + 2] = 0
    with (
        pytest.warns(CryptographyDeprecationWarning),
        pytest.raises(CertificateRefused, match="the certificate's serial is not a positive"),
    ):
        svid.parse(bytes(der))
    with pytest.raises(CertificateRefused, match=MALFORMED):
        svid.parse(bytes(der))  # where warnings are errors, as in this test suite


def test_the_signature_has_no_unused_bits() -> None:
    """An even last octet would allow the claim of one unused bit, outside what is signed."""
    der = draft_leaf(SITE).build()
    while der[-1] & 1:
        der = draft_leaf(SITE).build()
    size = len(svid.parse(der).signature)
    twisted = bytearray(der)
    twisted[-size - 1] = 1
    with pytest.raises(CertificateRefused, match="signature is not in whole octets"):
        svid.parse(bytes(twisted))


def test_an_svid_has_version_3() -> None:
    old = Mock(version=x509.Version.v1)
    with pytest.raises(CertificateRefused, match="the certificate is not of version 3"):
        svid.extensions(old)


def broken(attribute: str, error: Exception) -> Mock:
    certificate = Mock(version=x509.Version.v3)
    setattr(type(certificate), attribute, PropertyMock(side_effect=error))
    return certificate


def test_parts_the_library_finds_malformed_later() -> None:
    """`cryptography` parses lazily; what it raises at an access must not escape."""
    with pytest.raises(CertificateRefused, match=MALFORMED):
        svid.is_signed_by(broken("issuer", ValueError("bad")), SITE.anchor.subject, SITE.anchor.public_key)
    with pytest.raises(CertificateRefused, match=MALFORMED):
        svid.subject(broken("subject", ValueError("bad")))
    with pytest.raises(CertificateRefused, match=MALFORMED):
        svid.validity(broken("not_valid_before_utc", ValueError("bad")))
    for error in (ValueError("bad"), x509.DuplicateExtension("twice", UNKNOWN.oid)):
        with pytest.raises(CertificateRefused, match=MALFORMED):
            svid.extensions(broken("extensions", error))
    for flaw in (ValueError("bad"), UnsupportedAlgorithm("odd")):
        with pytest.raises(CertificateRefused, match=MALFORMED):
            svid.key_of(Mock(public_key=Mock(side_effect=flaw)))


TAIL = x509.UnrecognizedExtension(svid.WILDCARD, svid.WILDCARD_VALUE)


def test_a_wildcard_is_seen_where_it_is() -> None:
    assert svid.has_wildcard(leaf_with(NO_CA, USAGE, NAME, (TAIL, False)))
    assert not svid.has_wildcard(leaf_with(NO_CA, USAGE, NAME, (UNKNOWN, False)))
    assert svid.is_wildcard(draft_leaf(SITE, [NO_CA, USAGE, NAME, (TAIL, False)]).build())
    assert not svid.is_wildcard(SITE.leaf())


@pytest.mark.parametrize("value", [b"", b"\x05", b"\x05\x00\x00", b"\x01\x01\xff"])
def test_a_malformed_wildcard(value: bytes) -> None:
    flawed = x509.UnrecognizedExtension(svid.WILDCARD, value)
    with pytest.raises(CertificateRefused, match="the certificate's wildcard is malformed"):
        svid.has_wildcard(leaf_with(NO_CA, USAGE, NAME, (flawed, False)))


def test_a_critical_wildcard_is_not_ours() -> None:
    with pytest.raises(CertificateRefused, match=r"unknown critical extension 2\.25\.1769"):
        leaf_with(NO_CA, USAGE, NAME, (TAIL, True))


def test_an_authority_is_told_from_a_leaf_critical_or_not() -> None:
    assert not svid.is_authority(leaf_with(NO_CA, USAGE, NAME))
    for critical in (True, False):
        constraints = x509.BasicConstraints(ca=True, path_length=0)
        assert svid.is_authority(leaf_with((constraints, critical), USAGE, NAME))
