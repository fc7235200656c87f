import pytest

from rossec.discovery.candidates import MAX_CANDIDATES, Candidate, Candidates, Source
from rossec.errors import AnnouncementRefused
from tests.rossec.discovery.conftest import NOW, Make
from tests.support.site import Site

NEAR, FAR = Source("fe80::1%near", 1), Source("fe80::1%far", 2)


@pytest.fixture
def candidates(site: Site) -> Candidates:
    return Candidates(site.anchor)


def heard(candidates: Candidates, data: bytes, source: Source = NEAR) -> Candidate:
    found = candidates.heard(data, source, NOW, 1.0)
    assert found is not None
    return found


def test_the_shortest_way_is_best_once_it_is_reached(candidates: Candidates, make: Make) -> None:
    near, far = heard(candidates, make(1)), heard(candidates, make(1), FAR)
    assert candidates.best(NOW) is None
    assert near.endpoints == (("192.0.2.7", 11311), ("fe80::1%near", 11311))
    candidates.probed(far, far.endpoints[1], 0.004)
    assert candidates.best(NOW) is far
    candidates.probed(near, near.endpoints[0], 0.001)
    candidates.probed(near, near.endpoints[0], 0.009)
    assert candidates.best(NOW) is near
    assert near.rtt == 0.001
    assert near.endpoint == ("192.0.2.7", 11311)
    assert candidates.ranked(NOW) == [near, far]


def test_a_link_that_loses_much_is_worse_than_a_slow_one(
    candidates: Candidates, make: Make
) -> None:
    near, far = heard(candidates, make(1)), heard(candidates, make(1), FAR)
    for seq in (2, 3, 4):
        heard(candidates, make(seq), FAR)
    heard(candidates, make(4))
    assert (near.loss, far.loss) == (0.5, 0.0)
    candidates.probed(near, near.endpoints[0], 0.001)
    candidates.probed(far, far.endpoints[0], 0.5)
    assert candidates.best(NOW) is far


def test_who_falls_silent_is_forgotten(candidates: Candidates, make: Make) -> None:
    candidates.probed(one := heard(candidates, make()), ("h", 1), 0.1)
    assert candidates.best(NOW + 15) is one
    assert candidates.best(NOW + 16) is None
    assert candidates.ranked(NOW) == []


def test_an_announcement_counts_once_on_each_link(candidates: Candidates, make: Make) -> None:
    data = make()
    heard(candidates, data)
    echo = Source("fe80::bad%near", NEAR.link)
    assert candidates.heard(data, echo, NOW, 1.0) is None
    assert candidates.heard(data, NEAR, NOW, 1.0) is None
    assert [one.source for one in candidates.ranked(NOW)] == [NEAR]


def test_numbers_only_rise(candidates: Candidates, make: Make) -> None:
    heard(candidates, make(5))
    with pytest.raises(AnnouncementRefused, match="older than one heard before"):
        candidates.heard(make(4), NEAR, NOW, 1.0)
    with pytest.raises(AnnouncementRefused, match="older than one heard before"):
        candidates.heard(make(9, instance=b"previous", issued=NOW - 1), NEAR, NOW, 1.0)
    assert candidates.refused.most_common(1)[0][1] == 2


def test_a_restarted_master_begins_anew(candidates: Candidates, make: Make) -> None:
    candidates.probed(heard(candidates, make(5)), ("h", 1), 0.1)
    again = heard(candidates, make(0, instance=b"restart!"))
    assert again.rtt is None
    assert again.loss == 0
    assert candidates.ranked(NOW) == [again]


def test_signatures_are_checked_at_a_bounded_rate(candidates: Candidates) -> None:
    for _ in range(20):
        with pytest.raises(AnnouncementRefused, match="no announcement of this"):
            candidates.heard(b"garbage", NEAR, NOW, 1.0)
    with pytest.raises(AnnouncementRefused, match="more announcements than can be checked"):
        candidates.heard(b"garbage", NEAR, NOW, 1.0)
    with pytest.raises(AnnouncementRefused, match="no announcement of this"):
        candidates.heard(b"garbage", NEAR, NOW, 1.05)


def test_so_many_are_remembered_and_no_more(candidates: Candidates, make: Make) -> None:
    for number in range(MAX_CANDIDATES):
        source = Source(f"fe80::{number}%near", 100 + number)
        assert candidates.heard(make(), source, NOW, float(number)) is not None
    with pytest.raises(AnnouncementRefused, match="more masters"):
        candidates.heard(make(), FAR, NOW, 100.0)


def test_the_memory_of_numbers_is_bounded(candidates: Candidates, make: Make) -> None:
    for seq in range(300):
        assert candidates.heard(make(seq), NEAR, NOW, float(seq)) is not None
    assert len(candidates._seen) == 256
