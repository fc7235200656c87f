from ca.authority import Authority
from ca.certificates import build_intermediate_request
from ca.keys.signing import thumbprint
from ca.store.values import CertificateRow
from ca.svid import build_request
from tests.support.pki import DAY, NOW, Site, new_signer

SITE, HOST = Site.create(), new_signer()


def certified(name: str, *, wildcard: bool = False) -> CertificateRow:
    csr = build_request(new_signer(), "home", name)
    der = SITE.authority.issue(csr, now=NOW, serial=1, wildcard=wildcard)
    return CertificateRow(1, name, b"k" * 32, der, NOW, NOW + DAY)


def test_a_row_covers_what_its_certificate_does() -> None:
    anonymous, single = certified("/rviz", wildcard=True), certified("/rviz")
    assert (anonymous.wildcard, single.wildcard) == (True, False)
    assert anonymous.covers("/rviz_1")
    assert not single.covers("/rviz_1")
    assert single.covers("/rviz")
    assert not anonymous.covers("/b")


def test_the_issuer_of_a_row_is_the_intermediate_whose_key_signed_it() -> None:
    der = SITE.authority.issue_intermediate(
        build_intermediate_request(HOST, "home"), now=NOW, serial=2, may_enroll=True, lifetime=DAY
    )
    row = CertificateRow(2, "intermediate/x", thumbprint(HOST.public_key), der, NOW, NOW + DAY)
    csr = build_request(new_signer(), "home", "/below")
    leaf = Authority(HOST, SITE.root, der).issue(csr, now=NOW, serial=3)
    assert CertificateRow(3, "/below", b"b" * 32, leaf, NOW, NOW + DAY).is_signed_by(row)
    assert not certified("/robot").is_signed_by(row)
