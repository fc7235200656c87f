from pathlib import Path

import pytest

from ca.errors import CertificateRefused
from rossec.federation.exchange import MAX_CHAINS, Chains
from tests.support.site import Site


def test_the_chain_of_what_was_verified_is_kept(tmp_path: Path) -> None:
    site, chains = Site(tmp_path / "site"), Chains()
    verify = chains.recording(site.anchor.verify)
    chain = site.enroll("/master").credentials().chain
    assert chains.of(site.identity("/master")) == ()
    identity = verify(chain, site.now())
    assert chains.of(identity) == chain
    with pytest.raises(CertificateRefused):
        verify((b"rubbish",), site.now())


def test_they_are_bounded(tmp_path: Path) -> None:
    site, chains = Site(tmp_path / "site"), Chains()
    identities = [site.identity("/a"), *(site.identity(f"/n{i}") for i in range(3))]
    names = iter(identities * MAX_CHAINS)
    verify = chains.recording(lambda chain, now: next(names))
    for _ in range(MAX_CHAINS + 4):
        verify((b"c",), 0)
    assert chains.of(identities[0]) == (b"c",)
