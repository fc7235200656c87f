from pathlib import Path

import pytest

from ca.errors import DomainsRefused, RevocationRefused
from rossec.home import NodeHome
from rossec.saved_statements import LONGEST, DomainFiles
from tests.support.domains import Pair, domains, foreign, revoked
from tests.support.pki import NOW, Site

DOMAIN = "hospital.example"
KEY = b"k" * 32


@pytest.fixture
def pair() -> Pair:
    return Pair()


@pytest.fixture
def saved(tmp_path: Path, pair: Pair) -> DomainFiles:
    return DomainFiles(NodeHome(tmp_path / "robot", "/robot"), pair.home.anchor)


@pytest.fixture(autouse=True)
def _directory(tmp_path: Path) -> None:
    (tmp_path / "robot").mkdir(mode=0o700)


def test_nothing_is_saved_at_first(saved: DomainFiles, pair: Pair) -> None:
    assert (saved.load_domains(), saved.load_foreign(DOMAIN)) == (None, None)
    anchors = saved.anchors()
    assert anchors.current is None
    assert saved.trust_status(anchors, pair.own, NOW).foreign(DOMAIN) is None


def test_what_was_known_is_known_after_a_restart(saved: DomainFiles, pair: Pair) -> None:
    listed = domains(pair.home, foreign(pair.hospital))
    saved.save_domains(listed)
    saved.save_foreign(pair.hospital.anchor, revoked(pair.hospital, KEY, seq=3))
    anchors = saved.anchors()
    trust_status = saved.trust_status(anchors, pair.own, NOW)
    assert anchors.data == listed
    assert trust_status.revoked(DOMAIN) == {KEY}
    with pytest.raises(RevocationRefused, match="is older than"):
        trust_status.take_foreign(DOMAIN, revoked(pair.hospital, seq=2), b"", [], NOW)
    with pytest.raises(DomainsRefused, match="older"):
        anchors.update(domains(pair.home, seq=0))


def test_an_older_list_replaces_no_newer_one(saved: DomainFiles, pair: Pair) -> None:
    old, new = domains(pair.home), domains(pair.home, foreign(pair.hospital), seq=2)
    for data in (new, old, b"damaged"):
        saved.save_domains(data)
    assert saved.load_domains() == new
    old, new = revoked(pair.hospital), revoked(pair.hospital, KEY, seq=2)
    for data in (new, old, revoked(pair.home, seq=9)):
        saved.save_foreign(pair.hospital.anchor, data)
    assert saved.load_foreign(DOMAIN) == new


def test_a_damaged_file_is_replaced_and_loads_as_nothing(
    saved: DomainFiles, pair: Pair, tmp_path: Path
) -> None:
    saved.save_domains(domains(pair.home, foreign(pair.hospital)))
    saved.save_foreign(pair.hospital.anchor, b"damaged")
    trust_status = saved.trust_status(saved.anchors(), pair.own, NOW)
    found = trust_status.foreign(DOMAIN)
    assert found is not None
    assert found.data == b""
    data = revoked(pair.hospital)
    saved.save_foreign(pair.hospital.anchor, data)
    assert saved.load_foreign(DOMAIN) == data
    (tmp_path / "robot" / "domains.cose").write_bytes(b"damaged")
    with pytest.raises(DomainsRefused):
        saved.anchors()


def test_a_list_of_an_earlier_root_is_replaced(saved: DomainFiles, pair: Pair) -> None:
    saved.save_foreign(pair.hospital.anchor, revoked(pair.hospital, KEY, seq=9))
    new = Site.create(DOMAIN)
    data = revoked(new)
    saved.save_foreign(new.anchor, data)
    assert saved.load_foreign(DOMAIN) == data


def test_what_is_held_already_is_not_loaded_again(saved: DomainFiles, pair: Pair) -> None:
    pair.confirm_foreign(seq=5)
    saved.save_foreign(pair.hospital.anchor, revoked(pair.hospital, KEY, seq=6))
    saved.restore(pair.trust_status, NOW)
    assert pair.trust_status.revoked(DOMAIN) == frozenset()


@pytest.mark.parametrize("domain", ["..", "x" * 255])
def test_every_domain_is_the_name_of_a_file(saved: DomainFiles, tmp_path: Path, domain: str) -> None:
    site = Site.create(domain)
    saved.save_foreign(site.anchor, revoked(site))
    (found,) = (tmp_path / "robot" / "foreign").iterdir()
    assert found.suffix == ".cose"
    assert len(found.name) <= LONGEST + 5
    assert saved.load_foreign(domain) == found.read_bytes()


def test_the_files_are_of_their_owner_alone(saved: DomainFiles, pair: Pair, tmp_path: Path) -> None:
    saved.save_domains(domains(pair.home))
    saved.save_foreign(pair.hospital.anchor, revoked(pair.hospital))
    for path in (tmp_path / "robot").rglob("*.cose"):
        assert path.stat().st_mode & 0o777 == 0o600
