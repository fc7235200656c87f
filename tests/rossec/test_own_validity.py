"""What a node says of its own identity when it is over, by what is in its directory."""

import os
import time
from pathlib import Path

import pytest

from ca.errors import CertificateExpired
from rossec.home import ended, has_key, seen_in
from tests.support.site import DAY, Site

NOW = int(time.time())
LIFE = 30 * DAY


@pytest.fixture
def site(tmp_path: Path) -> Site:
    """Its nodes were enrolled 60 days ago for 30, and their files are of then."""
    return Site(tmp_path / "site", clock=lambda: NOW - 60 * DAY)


def age(directory: Path, moment: int) -> None:
    for path in (*directory.rglob("*"), directory):
        os.utime(path, (moment, moment))


def test_files_or_a_list_of_later_show_that_it_really_ended(site: Site) -> None:
    home = site.enroll("/robot", LIFE)
    age(home.path, NOW - 60 * DAY)
    with pytest.raises(CertificateExpired, match="by this host's clock, which says"):
        home.identity(NOW)
    site.authority.sign_list(NOW - 2 * DAY)
    home.save_revocations(site.authority.store.newest_list() or b"")
    age(home.path, NOW - 60 * DAY)
    with pytest.raises(CertificateExpired, match=r"^the identity of /robot ended on"):
        home.identity(NOW)
    (home.path / "revocations.cose").unlink()
    os.utime(home.path / "grants")
    with pytest.raises(CertificateExpired, match=r"^the identity of /robot ended on"):
        home.identity(NOW)


def test_in_2038_everything_is_over(site: Site) -> None:
    home = site.enroll("/robot", LIFE)
    with pytest.raises(CertificateExpired, match="everything of 'home' is over") as caught:
        home.identity(NOW + 12 * 365 * DAY)
    assert "renew" not in caught.value.hint
    assert "set this host's clock" in caught.value.hint


def test_a_list_of_another_authority_says_nothing(site: Site, tmp_path: Path) -> None:
    other = Site(tmp_path / "other")
    home = site.enroll("/robot", LIFE)
    age(home.path, NOW - 60 * DAY)
    found = seen_in(home.path, site.anchor, other.authority.store.newest_list())
    assert found == NOW - 60 * DAY
    assert seen_in(tmp_path / "nowhere", site.anchor, None) == site.anchor.not_before


def test_the_first_of_the_chain_to_end_counts(site: Site) -> None:
    home = site.enroll("/robot", LIFE)
    chain = home.credentials().chain
    error = ended("/robot", chain, site.anchor, NOW, NOW)
    assert str(error).startswith("the identity of /robot ended on")


def test_who_asks_for_a_key_that_is_there_is_told_what_there_is(site: Site) -> None:
    home = site.enroll("/robot", LIFE)
    assert "rossec ca renew --expired /robot" in has_key("/robot", home.path)
    (home.path / "node.pem").unlink()
    assert f"its request is {home.path / 'node.csr'}" in has_key("/robot", home.path)
