"""Whom a home trusts, and that a URI which is set is kept."""

from pathlib import Path

import pytest

from ca.certificates import TrustAnchor
from ca.revocation.lists import is_tree
from rossec.discovery import local_links
from rossec.discovery.announcement import Announcement, Candidate, DatagramSource
from rossec.discovery.local_links import PATIENCE, SETTLE
from rossec.errors import ConfigurationError, MasterNotFound
from rossec.home import NodeHome
from tests.support.site import Site


def test_a_damaged_authority_is_named_by_its_file(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    site.enroll("/robot")
    file = site.enroll("/odd").path / "ca.pem"
    for damaged in (b"garbage", 2 * file.read_bytes()):
        file.write_bytes(damaged)
        with pytest.raises(ConfigurationError, match=r"nodes/odd/ca\.pem: ") as refused:
            local_links.trusted(site.root, None)
        assert "anew" in refused.value.hint


def test_the_trust_anchor_decides_the_master(home: Site, elsewhere: Site, tmp_path: Path) -> None:
    assert local_links.trusted(home.root, None)[0].thumbprint == home.anchor.thumbprint
    assert local_links.trusted(home.root, "/robot")[1] == frozenset()
    with pytest.raises(ConfigurationError, match="no node is enrolled"):
        local_links.trusted(tmp_path, None)
    for part in ("ca.pem", "node.pem"):
        target = home.root / "nodes" / "stray" / part
        target.parent.mkdir(exist_ok=True)
        target.write_bytes((elsewhere.root / "nodes" / "master" / part).read_bytes())
    with pytest.raises(ConfigurationError, match="different authorities"):
        local_links.trusted(home.root, None)
    for part in ("ca.pem", "node.pem"):
        (home.root / "nodes" / "stray" / part).unlink()


def test_what_is_known_to_be_revoked_counts(home: Site) -> None:
    newest = home.authority.store.newest_list()
    assert newest is not None
    robot = home.enroll("/robot")
    home.revoke(home.identity("/master").thumbprint)
    newest = home.authority.store.newest_list()
    assert newest is not None
    robot.save_revocations(newest)
    assert home.identity("/master").thumbprint in local_links.trusted(home.root, "/robot")[1]


def test_a_tree_of_revocations_leaves_it_to_the_handshake(
    elsewhere: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    robot = elsewhere.enroll("/robot")
    elsewhere.revoke(elsewhere.identity("/master").thumbprint)
    newest = elsewhere.authority.store.newest_list()
    assert newest is not None
    assert is_tree(newest)
    robot.save_revocations(newest)
    assert local_links.trusted(elsewhere.root, "/robot")[1] == frozenset()


async def test_a_uri_that_is_set_is_kept(home: Site) -> None:
    environ = {"ROS_MASTER_URI": "http://robot:11311"}
    assert await local_links.discover_master(environ, None) == environ


async def test_the_best_master_that_answers_is_chosen(home: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []
    announced = Announcement("192.0.2.7", 11311, b"instance", 0, 0)
    source = DatagramSource("fe80::1", 1)
    near, far = (Candidate(key * 32, "/master", source, announced) for key in (b"k", b"o"))
    near.endpoint = "fd00::7", 11311

    async def find(
        anchor: TrustAnchor, revoked: object, *, patience: float, settle: float
    ) -> list[Candidate]:
        asked.append((anchor.thumbprint, patience, settle))
        return [near, far]

    monkeypatch.setattr(local_links, "find", find)
    environ = {"ROS_MASTER_URI": "discover:", "ROSSEC_HOME": str(home.root), "ROS_IP": "::1"}
    found = await local_links.discover_master(environ, "/robot")
    assert found == {**environ, "ROS_MASTER_URI": "http://[fd00::7]:11311"}
    assert asked == [(home.anchor.thumbprint, PATIENCE, SETTLE)]
    own = NodeHome.of(home.root, "/robot")
    assert await local_links.discover_master(environ, own, settle=1) == found
    assert asked[1:] == [(home.anchor.thumbprint, PATIENCE, 1)]
    far.name = "/master/kitchen"
    other = await local_links.discover_master({**environ, "ROSSEC_MASTER": far.name}, "/robot")
    assert other["ROS_MASTER_URI"] == "http://192.0.2.7:11311"
    with pytest.raises(MasterNotFound, match=r"/master/hall does not .*, but /master, /master/kit"):
        await local_links.discover_master({**environ, "ROSSEC_MASTER": "/master/hall"}, "/robot")
    assert local_links.uri_of(far) == "http://192.0.2.7:11311"
