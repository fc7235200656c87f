from collections.abc import Iterator
from pathlib import Path

import pytest

from ca.domains import Anchors, open_domains
from ca.keys.signing import to_coordinates
from rossec.authority import signing
from tests.support import trust
from tests.support.site import DAY, Site


class Clock:
    """A time that tests set."""

    def __init__(self) -> None:
        self.at = 1_800_000_000.0

    def __call__(self) -> float:
        return self.at


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def home(tmp_path: Path, clock: Clock) -> Iterator[Site]:
    site = Site(tmp_path / "home", "home", clock)
    yield site
    site.authority.store.close()


@pytest.fixture
def hospital(tmp_path: Path, clock: Clock) -> Iterator[Site]:
    site = Site(tmp_path / "hospital", "hospital", clock)
    yield site
    site.authority.store.close()


def is_due(site: Site) -> bool:
    return signing.is_domain_list_due(site.authority.store, site.anchor, site.now())


def keys(site: Site, *names: str) -> tuple[bytes, ...]:
    return tuple(sorted(to_coordinates(site.identity(name).public_key) for name in names))


def test_one_domain_with_one_master_has_no_list(home: Site) -> None:
    home.enroll("/master")
    home.enroll("/robot")
    home.authority.refresh_list(home.now())
    assert not is_due(home)
    assert home.authority.store.domains.newest_list() == b""


def test_a_second_master_makes_a_list_of_the_keys_of_both(home: Site) -> None:
    home.enroll("/master")
    home.enroll("/master/kitchen")
    data = home.authority.store.domains.newest_list()
    listed = open_domains(data, home.anchor)
    assert (listed.number, listed.domains) == ((1, 1), ())
    assert listed.masters == keys(home, "/master", "/master/kitchen")
    assert not is_due(home)
    home.authority.store.log.audit(home.anchor.public_key)


def test_the_keys_of_masters_that_are_revoked_or_over_leave_the_list(home: Site, clock: Clock) -> None:
    home.enroll("/master", 10 * DAY)
    home.enroll("/master/attic", 10 * DAY)
    home.enroll("/master/kitchen", 2 * DAY)
    home.revoke(home.identity("/master/attic").thumbprint)
    home.authority.refresh_list(home.now())
    assert signing.required_masters(home.authority.store, home.now()) == keys(
        home, "/master", "/master/kitchen"
    )
    expected = keys(home, "/master")
    clock.at += 3 * DAY
    assert is_due(home)
    home.authority.refresh_list(home.now())
    data = home.authority.store.domains.newest_list()
    assert open_domains(data, home.anchor).masters == expected


def test_an_accepted_domain_is_listed_until_its_time_is_over(
    home: Site, hospital: Site, clock: Clock
) -> None:
    data = trust.accept(home, hospital, "clinic", lifetime=DAY)
    (entry,) = open_domains(data, home.anchor).domains
    assert (entry.domain, entry.label, entry.until) == ("hospital", "clinic", home.now() + DAY)
    assert signing.required_domains(home.authority.store, home.now()) == (entry,)
    assert not is_due(home)
    clock.at += DAY
    assert is_due(home)
    home.authority.refresh_list(home.now())
    newest = open_domains(home.authority.store.domains.newest_list(), home.anchor)
    assert (newest.number, newest.domains) == ((1, 2), ())


def test_a_removed_domain_is_cut_by_the_next_list(home: Site, hospital: Site) -> None:
    anchors = Anchors(home.anchor)
    assert anchors.update(trust.accept(home, hospital)) == frozenset()
    chain = [hospital.identity("/robot").certificate]
    assert anchors.verify(chain, home.now()).name == "/remote/hospital/robot"
    assert anchors.update(trust.remove(home, "hospital")) == {"hospital"}
    assert not is_due(home)
    home.authority.store.log.audit(home.anchor.public_key)


def test_an_old_list_is_signed_anew(home: Site, hospital: Site, clock: Clock) -> None:
    trust.accept(home, hospital, lifetime=100 * DAY)
    clock.at += signing.DOMAIN_LIST_REFRESH
    assert not is_due(home)
    clock.at += 1
    assert is_due(home)
    home.authority.refresh_list(home.now())
    listed = open_domains(home.authority.store.domains.newest_list(), home.anchor)
    assert (listed.seq, listed.expires) == (2, home.now() + signing.DOMAIN_LIST_LIFETIME)


def test_a_new_epoch_beats_every_list_before(home: Site, hospital: Site) -> None:
    before = open_domains(trust.accept(home, hospital), home.anchor)
    listed = signing.sign_domain_list(
        home.authority.authority, home.authority.store, home.now(), new_epoch=True
    )
    assert listed.number > (before.epoch, 1 << 40)
    assert listed.domains == before.domains
