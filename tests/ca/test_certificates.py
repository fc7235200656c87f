import dataclasses

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from hypothesis import given, settings
from hypothesis import strategies as st

from ca import certificates, svid
from ca.certificates import Identity, TrustAnchor, from_pem, to_pem
from ca.errors import CertificateExpired, CertificateNotYetValid, CertificateRefused, ForeignCertificate
from ca.keys.signing import thumbprint
from ca.svid import MAX_CERTIFICATE, WILDCARD, WILDCARD_VALUE
from tests.support.pki import (
    DAY,
    NOW,
    Extensions,
    Site,
    draft_leaf,
    draft_root,
    leaf_extensions,
    root_extensions,
    uris,
)

SITE = Site.create()
LEAF = SITE.leaf()


def test_an_identity_in_full() -> None:
    identity = SITE.anchor.verify([LEAF], NOW)
    assert identity == Identity(
        domain="home",
        name="/robot1/camera",
        public_key=identity.public_key,
        thumbprint=thumbprint(identity.public_key),
        not_before=NOW - 3600,
        not_after=NOW + 30 * DAY,
        serial=2,
        certificate=LEAF,
    )
    assert identity.public_key == x509.load_der_x509_certificate(LEAF).public_key()


def test_an_anchor_in_full() -> None:
    anchor = TrustAnchor.load(SITE.root)
    assert (anchor.domain, anchor.certificate) == ("home", SITE.root)
    assert anchor.thumbprint == thumbprint(SITE.key.public_key())
    assert (anchor.not_before, anchor.not_after) == (NOW - 3600, NOW + 3650 * DAY)


@pytest.mark.parametrize("count", [0, 3])
def test_a_chain_is_one_certificate_or_two(count: int) -> None:
    message = f"a chain of {count} certificates where one or two are expected"
    with pytest.raises(CertificateRefused, match=message):
        SITE.anchor.verify([LEAF] * count, NOW)


def test_a_certificate_of_another_authority_is_foreign() -> None:
    stranger = Site.create()
    with pytest.raises(ForeignCertificate, match=r"not signed by the authority of .* 'home'"):
        SITE.anchor.verify([stranger.leaf()], NOW)


def test_a_stranger_who_copies_the_name_of_the_authority() -> None:
    draft = draft_leaf(SITE)
    forged = dataclasses.replace(draft, key=ec.generate_private_key(ec.SECP256R1())).build()
    with pytest.raises(ForeignCertificate):
        SITE.anchor.verify([forged], NOW)


def test_a_node_is_no_authority() -> None:
    """A node signs a certificate with its own key, under its own certificate."""
    node = draft_leaf(SITE)
    forged = dataclasses.replace(node, issuer=node.subject, key=draft_root().key).build()
    with pytest.raises(ForeignCertificate):
        SITE.anchor.verify([forged], NOW)


def test_the_root_is_not_a_node() -> None:
    with pytest.raises(CertificateRefused, match="has no critical basic constraints with CA false"):
        SITE.anchor.verify([SITE.root], NOW)


@pytest.mark.parametrize("now", [NOW - 3600, NOW, NOW + 30 * DAY])
def test_valid_from_the_first_to_the_last_second(now: int) -> None:
    assert SITE.anchor.verify([LEAF], now).name == "/robot1/camera"


def test_an_expired_certificate_is_refused() -> None:
    with pytest.raises(CertificateExpired, match="certificate of /robot1/camera expired 1 s ago"):
        SITE.anchor.verify([LEAF], NOW + 30 * DAY + 1)


def test_a_certificate_not_yet_valid_is_refused() -> None:
    leaf = SITE.leaf(now=NOW + DAY)
    message = "certificate of /robot1/camera becomes valid in 23 h"
    with pytest.raises(CertificateNotYetValid, match=message) as caught:
        SITE.anchor.verify([leaf], NOW)
    assert "clock" in caught.value.hint


def test_the_authority_has_its_time_too() -> None:
    leaf = dataclasses.replace(draft_leaf(SITE), start=NOW - 9 * DAY, end=NOW + 4000 * DAY).build()
    with pytest.raises(CertificateExpired, match="the authority's certificate expired 1 s ago"):
        SITE.anchor.verify([leaf], NOW + 3650 * DAY + 1)
    with pytest.raises(CertificateNotYetValid, match="authority's certificate becomes valid in 1 s"):
        SITE.anchor.verify([leaf], NOW - 3601)


@pytest.mark.parametrize(
    ("extensions", "message"),
    [
        (leaf_extensions("spiffe://lab/a"), "is for trust domain 'lab', not 'home'"),
        (leaf_extensions("spiffe://home/a/"), "the certificate's name is invalid: '/a/' is not"),
        (leaf_extensions("spiffe://home"), "the certificate's name is invalid: '' is not"),
        (leaf_extensions("https://home/a"), "the certificate's name is invalid: 'https://home/a'"),
        ([*leaf_extensions()[:2], (uris(), True)], "has 0 names where exactly one"),
    ],
)
def test_invalid_names_are_refused(extensions: Extensions, message: str) -> None:
    with pytest.raises(CertificateRefused, match=message):
        SITE.anchor.verify([draft_leaf(SITE, extensions).build()], NOW)


def test_every_byte_of_a_certificate_counts() -> None:
    for position in range(len(LEAF)):
        for change in (0x01, 0x80, 0xFF):
            damaged = bytearray(LEAF)
            damaged[position] ^= change
            with pytest.raises(CertificateRefused):
                SITE.anchor.verify([bytes(damaged)], NOW)


def test_every_byte_of_an_anchor_counts() -> None:
    for position in range(len(SITE.root)):
        for change in (0x01, 0x80, 0xFF):
            damaged = bytearray(SITE.root)
            damaged[position] ^= change
            with pytest.raises(CertificateRefused):
                TrustAnchor.load(bytes(damaged))


def test_every_truncation_and_a_tail() -> None:
    for size in range(len(LEAF)):
        with pytest.raises(CertificateRefused):
            SITE.anchor.verify([LEAF[:size]], NOW)
    with pytest.raises(CertificateRefused):
        SITE.anchor.verify([LEAF + b"\0"], NOW)


@settings(max_examples=200)
@given(st.binary(max_size=600))
def test_garbage_is_not_a_certificate(data: bytes) -> None:
    with pytest.raises(CertificateRefused, match="this is not a well-formed certificate"):
        SITE.anchor.verify([data], NOW)


def test_size_comes_first() -> None:
    with pytest.raises(CertificateRefused, match="a certificate of 2049 bytes where at most 2048"):
        SITE.anchor.verify([bytes(MAX_CERTIFICATE + 1)], NOW)


def test_an_anchor_signs_itself() -> None:
    with pytest.raises(CertificateRefused, match="is not signed by itself") as caught:
        TrustAnchor.load(LEAF)
    assert "ca.pem" in caught.value.hint


@pytest.mark.parametrize(
    ("uri", "message"),
    [
        ("spiffe://Home", "the authority's name is invalid: 'Home' is not a trust domain"),
        ("spiffe://home/a", "the authority's name is invalid: 'home/a' is not a trust domain"),
        ("https://home", "the authority's name is not a SPIFFE trust domain"),
    ],
)
def test_anchors_without_a_domain(uri: str, message: str) -> None:
    with pytest.raises(CertificateRefused, match=message):
        TrustAnchor.load(draft_root(root_extensions(uri)).build())


def test_pem_round_trip() -> None:
    bundle = to_pem(LEAF, SITE.root)
    assert bundle.count(b"BEGIN CERTIFICATE") == 2
    assert from_pem(bundle) == (LEAF, SITE.root)


@pytest.mark.parametrize("data", [b"", b"garbage", to_pem(LEAF)[:-40], LEAF])
def test_text_without_pem_is_refused(data: bytes) -> None:
    with pytest.raises(CertificateRefused, match="this is not a PEM certificate") as caught:
        from_pem(data)
    assert "rossec ca sign" in caught.value.hint


def test_too_large_pem_is_refused() -> None:
    with pytest.raises(CertificateRefused, match="16385 bytes of PEM where at most 16384"):
        from_pem(bytes(16385))


def test_garbage_in_pem_is_refused() -> None:
    with pytest.raises(CertificateRefused, match="not a well-formed certificate"):
        to_pem(b"garbage")


TAIL = (x509.UnrecognizedExtension(WILDCARD, WILDCARD_VALUE), False)


def with_tail(uri: str) -> bytes:
    return draft_leaf(SITE, [*leaf_extensions(uri), TAIL]).build()


def test_an_identity_with_a_wildcard_tail() -> None:
    identity = SITE.anchor.verify([with_tail("spiffe://home/robot1/rviz")], NOW)
    assert (identity.name, identity.wildcard) == ("/robot1/rviz", True)
    assert identity.covers("/robot1/rviz")
    assert identity.covers("/robot1/rviz_17")
    assert not identity.covers("/robot1/rviz_a/b")


def test_an_identity_without_one_covers_its_name() -> None:
    identity = SITE.anchor.verify([LEAF], NOW)
    assert not identity.wildcard
    assert identity.covers("/robot1/camera")
    assert not identity.covers("/robot1/camera_17")


@pytest.mark.parametrize("name", ["/master", "/ca"])
def test_no_tail_for_the_master_and_the_authority(name: str) -> None:
    with pytest.raises(CertificateRefused, match=f"{name} is a single node"):
        SITE.anchor.verify([with_tail(f"spiffe://home{name}")], NOW)


def counted(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """The signatures that are verified from here on."""
    found: list[bytes] = []
    verifies = svid.CertificateSignature.verifies

    def verify(signed: svid.CertificateSignature, key: ec.EllipticCurvePublicKey) -> bool:
        found.append(signed.signature)
        return verifies(signed, key)

    monkeypatch.setattr(svid.CertificateSignature, "verifies", verify)
    return found


def test_a_chain_is_verified_once_and_its_times_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    leaf, verified = SITE.leaf(), counted(monkeypatch)
    identity = SITE.anchor.verify([leaf], NOW)
    assert SITE.anchor.verify((leaf,), NOW) is identity
    assert len(verified) == 1
    with pytest.raises(CertificateExpired):
        SITE.anchor.verify([leaf], NOW + 31 * DAY)
    assert SITE.anchor.verify([leaf], NOW) is identity  # a clock that was set back, for the tests' sake
    with pytest.raises(ForeignCertificate):  # another authority of the same trust domain
        Site.create().anchor.verify([leaf], NOW)


def test_only_chains_that_verified_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    site = Site.create(now=NOW - 100 * DAY)
    leaf, verified = site.leaf(), counted(monkeypatch)
    damaged = leaf[:-1] + bytes([leaf[-1] ^ 1])
    for _ in range(2):
        with pytest.raises(ForeignCertificate):
            site.anchor.verify([damaged], NOW)
    assert len(verified) == 2
    assert not site.anchor.has_verified([damaged])
    expired = site.leaf(now=NOW - 100 * DAY)  # signed, so its form is kept; its time is over each time
    for _ in range(2):
        with pytest.raises(CertificateExpired):
            site.anchor.verify([expired], NOW)
    assert len(verified) == 3


def test_so_many_chains_of_one_root_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(certificates, "CHAINS", 2)
    site, other = Site.create(), Site.create("hospital.example")
    first, *rest = (site.leaf() for _ in range(3))
    foreign = other.leaf()
    other.anchor.verify([foreign], NOW)
    identity = site.anchor.verify([first], NOW)
    for leaf in rest:
        site.anchor.verify([leaf], NOW)
    assert not site.anchor.has_verified([first])
    assert site.anchor.verify([first], NOW) == identity
    assert [site.anchor.has_verified([leaf]) for leaf in rest] == [False, True]
    assert other.anchor.has_verified([foreign])  # one authority's chains push out none of another's


def test_one_root_is_one_anchor() -> None:
    site = Site.create()
    assert TrustAnchor.load(site.root) is TrustAnchor.load(site.root)
    assert TrustAnchor.load(Site.create().root) is not TrustAnchor.load(site.root)
