import pytest

from ca.enrollment.messages import check_issued
from ca.errors import EnrollmentRefused
from ca.svid import build_request, check_request
from tests.support.pki import DAY, NOW, Site, new_signer

HOME, OTHER, KEY = Site.create(), Site.create(), new_signer()
CSR = build_request(KEY, "home", "/robot")
OWN = check_request(CSR, "home")


def issued(csr: bytes = CSR, site: Site = HOME, *, wildcard: bool = False) -> list[bytes]:
    return [site.authority.issue(csr, now=NOW, serial=3, lifetime=DAY, wildcard=wildcard)]


def test_its_own_identity() -> None:
    assert check_issued(HOME.root, issued(), OWN, NOW).thumbprint == HOME.anchor.thumbprint


@pytest.mark.parametrize(
    ("root", "chain", "now", "error"),
    [
        (b"rubbish", issued(), NOW, "invalid offer"),
        (HOME.root, [], NOW, "invalid offer"),
        (HOME.root, issued(site=OTHER), NOW, "invalid offer"),
        (HOME.root, issued(), NOW + DAY + 1, "expired"),
        (HOME.root, issued(build_request(new_signer(), "home", "/robot")), NOW, "another key"),
        (HOME.root, issued(build_request(KEY, "home", "/robot2")), NOW, "another name"),
        (HOME.root, issued(wildcard=True), NOW, "another name"),
    ],
)
def test_any_other_is_refused(root: bytes, chain: list[bytes], now: int, error: str) -> None:
    with pytest.raises(EnrollmentRefused, match=error):
        check_issued(root, chain, OWN, now)
