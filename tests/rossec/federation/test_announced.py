import time
from collections.abc import Callable
from pathlib import Path

import pytest

from rossec.discovery.announcement import Announcement, Candidates, DatagramSource, sign
from rossec.federation import mesh
from rossec.federation.mesh import AnnouncedMasters
from rossec.federation.settings import SiteSettings
from tests.support.site import Site

Hear = Callable[..., None]
LINK = DatagramSource("fe80::1", 1)


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site")


@pytest.fixture
def candidates(site: Site) -> Candidates:
    return Candidates(site.anchor)


@pytest.fixture
def hear(site: Site, candidates: Candidates) -> Hear:
    def heard(
        name: str, seq: int, *, port: int = 11311, instance: bytes = b"instance", reached: bool = True
    ) -> None:
        own = site.enroll(name).credentials()
        said = Announcement("10.0.0.7", port, instance, seq, site.now(), version=seq)
        found = candidates.heard(sign(own.signer, own.chain, said), LINK, site.now(), time.monotonic())
        assert found is not None
        if reached:
            candidates.probed(found, ("10.0.0.7", port), 0.001)

    return heard


def test_every_other_master_that_answers(site: Site, candidates: Candidates, hear: Hear) -> None:
    masters = AnnouncedMasters(site.enroll("/master/hall"), candidates)
    hear("/master", 0)
    hear("/master/hall", 0, instance=b"hallhall")
    hear("/master/kitchen", 0, instance=b"kitchenk", port=11411)
    hear("/master/cellar", 0, instance=b"cellarce", reached=False)
    assert masters.sites() == (
        SiteSettings("master", "http://10.0.0.7:11311", "/master"),
        SiteSettings("kitchen", "http://10.0.0.7:11411", "/master/kitchen"),
    )
    assert masters.take_returned() == {"/master", "/master/kitchen"}
    masters.sites()
    assert masters.take_returned() == set()


def test_one_that_was_restarted_is_dialled_at_once(site: Site, candidates: Candidates, hear: Hear) -> None:
    masters = AnnouncedMasters(site.enroll("/master/hall"), candidates)
    hear("/master", 0)
    masters.sites()
    masters.take_returned()
    hear("/master", 0, instance=b"anothero", port=11511)
    assert [each.uri for each in masters.sites()] == ["http://10.0.0.7:11511"]
    assert masters.take_returned() == {"/master"}


def test_one_that_is_not_heard_any_more_goes(
    site: Site, candidates: Candidates, hear: Hear, monkeypatch: pytest.MonkeyPatch
) -> None:
    masters = AnnouncedMasters(site.enroll("/master/hall"), candidates)
    hear("/master", 0)
    assert masters.sites()
    monkeypatch.setattr(mesh, "SILENT", 0.0)
    assert masters.sites(), "its facts may stay"
    monkeypatch.setattr(mesh, "LOST_FOR", 0.0)
    assert masters.sites() == ()
