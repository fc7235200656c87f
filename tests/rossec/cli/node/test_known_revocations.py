"""What this machine knows to be revoked, wherever it lies."""

from pathlib import Path

import pytest

from rossec.authority.home import AuthorityHome
from rossec.cli.node.doctor import known_revocations
from rossec.home import NodeHome
from rossec.ros.names import MASTER
from tests.support.site import Site

KEY, OTHER = b"k" * 32, b"o" * 32
NOW = 1_800_000_000


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site")


def test_without_lists_nothing_is_revoked(site: Site) -> None:
    assert known_revocations(site.root, site.enroll("/robot")) == {}


def test_every_list_counts_with_its_path(site: Site) -> None:
    node, master = site.enroll("/robot"), site.enroll(MASTER)
    node.save_revocations(site.revoke(KEY))
    master.save_revocations(site.revoke(OTHER))
    assert known_revocations(site.root, node) == {
        KEY: f"the list in {node.path}",
        OTHER: f"the list in {master.path}",
    }


def test_a_tree_counts_with_its_entries(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    node, master = site.enroll("/robot"), site.enroll(MASTER)
    tree = site.revoke(KEY)
    node.save_revocations(tree)  # which holds no entries of it
    assert known_revocations(site.root, node) == {}
    master.save_revocations(tree)
    assert site.entries is not None
    master.save_entries(site.entries)
    assert set(known_revocations(site.root, node)) == {KEY}


def test_the_record_of_the_local_authority_comes_first(site: Site, tmp_path: Path) -> None:
    authority = AuthorityHome.create(tmp_path / "home", "home", "four random words here", NOW)
    own = NodeHome(authority.path / "node", "/ca")
    authority.store().revoke(KEY, "stolen", NOW)
    root = tmp_path / "home"
    assert known_revocations(root, own) == {KEY: f"the authority's record in {root / 'ca'}"}
    assert known_revocations(root, site.enroll("/robot")) == {}  # of another authority
