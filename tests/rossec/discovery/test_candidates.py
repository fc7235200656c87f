import pytest

from rossec.discovery.announcement import (
    MAX_CANDIDATES,
    Announcement,
    Candidate,
    Candidates,
    DatagramSource,
    sign,
)
from rossec.errors import AnnouncementRefused
from tests.rossec.discovery.conftest import NOW, Make
from tests.support.site import Site

NEAR, FAR = DatagramSource("fe80::1%near", 1), DatagramSource("fe80::1%far", 2)


@pytest.fixture
def candidates(site: Site) -> Candidates:
    return Candidates(site.anchor)


def heard(candidates: Candidates, data: bytes, source: DatagramSource = NEAR) -> Candidate:
    found = candidates.heard(data, source, NOW, 1.0)
    assert found is not None
    return found


def test_the_shortest_way_is_best_once_it_is_reached(candidates: Candidates, make: Make) -> None:
    near, far = heard(candidates, make(1)), heard(candidates, make(1), FAR)
    assert candidates.best(NOW, 1.0) is None
    assert near.endpoints == (("192.0.2.7", 11311), ("fe80::1%near", 11311))
    candidates.probed(far, far.endpoints[1], 0.004)
    assert candidates.best(NOW, 1.0) is far
    candidates.probed(near, near.endpoints[0], 0.001)
    candidates.probed(near, near.endpoints[0], 0.009)
    assert candidates.best(NOW, 1.0) is near
    assert near.rtt == 0.001
    assert near.endpoint == ("192.0.2.7", 11311)
    assert candidates.ranked(NOW, 1.0) == [near, far]


def test_a_link_that_loses_much_is_worse_than_a_slow_one(candidates: Candidates, make: Make) -> None:
    near, far = heard(candidates, make(1)), heard(candidates, make(1), FAR)
    for seq in (2, 3, 4):
        heard(candidates, make(seq), FAR)
    heard(candidates, make(4))
    assert (near.loss(1.0), far.loss(1.0)) == (0.5, 0.0)
    candidates.probed(near, near.endpoints[0], 0.001)
    candidates.probed(far, far.endpoints[0], 0.5)
    assert candidates.best(NOW, 1.0) is far


def test_a_silent_master_is_forgotten(candidates: Candidates, make: Make) -> None:
    candidates.probed(one := heard(candidates, make()), ("h", 1), 0.1)
    assert candidates.best(NOW + 15, 1.0) is one
    assert candidates.best(NOW + 16, 1.0) is None
    assert candidates.ranked(NOW, 1.0) == []


def test_an_announcement_counts_once_on_each_link(candidates: Candidates, make: Make) -> None:
    data = make()
    heard(candidates, data)
    echo = DatagramSource("fe80::bad%near", NEAR.link)
    assert candidates.heard(data, echo, NOW, 1.0) is None
    assert candidates.heard(data, NEAR, NOW, 1.0) is None
    assert [one.source for one in candidates.ranked(NOW, 1.0)] == [NEAR]


def test_numbers_only_rise(candidates: Candidates, make: Make) -> None:
    heard(candidates, make(5))
    with pytest.raises(AnnouncementRefused, match="older than one received before"):
        candidates.heard(make(4), NEAR, NOW, 1.0)
    with pytest.raises(AnnouncementRefused, match="older than one received before"):
        candidates.heard(make(9, instance=b"previous", issued=NOW - 1), NEAR, NOW, 1.0)
    assert candidates.refused.most_common(1)[0][1] == 2


def test_a_restarted_master_begins_anew(candidates: Candidates, make: Make) -> None:
    candidates.probed(heard(candidates, make(5)), ("h", 1), 0.1)
    again = heard(candidates, make(0, instance=b"restart!"))
    assert again.rtt is None
    assert again.loss(1.0) == 0
    assert candidates.ranked(NOW, 1.0) == [again]


def test_a_malformed_announcement_costs_no_check(candidates: Candidates, make: Make) -> None:
    for data in (b"", b"x", bytes(2048), make(issued=NOW - 60), make(issued=NOW + 60)):
        for _ in range(500):
            with pytest.raises(AnnouncementRefused, match=r"no announcement of this|another time"):
                candidates.heard(data, NEAR, NOW, 1.0)
    assert heard(candidates, make()).source == NEAR


def test_a_repetition_costs_no_check(candidates: Candidates, make: Make) -> None:
    heard(candidates, data := make(1))
    for _ in range(500):
        assert candidates.heard(data, NEAR, NOW, 1.0) is None
    heard(candidates, make(2))


def flood(candidates: Candidates, data: bytes, *sources: DatagramSource) -> int:
    """How many of these were not even checked."""
    unchecked = 0
    for source in sources:
        with pytest.raises(AnnouncementRefused) as refused:
            candidates.heard(data, source, NOW, 1.0)
        unchecked += "more announcements than can be checked" in str(refused.value)
    return unchecked


def addresses(count: int) -> list[DatagramSource]:
    return [DatagramSource(f"fe80::{number:x}%near", NEAR.link) for number in range(count)]


def test_one_address_uses_its_own_bucket(candidates: Candidates, make: Make, elsewhere: Site) -> None:
    foreign = elsewhere.enroll("/master").credentials()
    rubbish = sign(foreign.signer, foreign.chain, Announcement("h", 1, b"instance", 9, NOW))
    assert flood(candidates, rubbish, *[FAR] * 100) > 0
    heard(candidates, make(1))


def test_many_addresses_do_not_block_a_verified_one(candidates: Candidates, make: Make) -> None:
    forged = bytearray(make(7))
    forged[-1] ^= 1
    heard(candidates, make(1))
    assert flood(candidates, bytes(forged), *addresses(500)) > 0
    heard(candidates, make(2))


def test_new_chains_do_not_block_verified_ones(candidates: Candidates, make: Make, elsewhere: Site) -> None:
    heard(candidates, make(1))
    foreign = elsewhere.enroll("/master").credentials()
    rubbish = sign(foreign.signer, foreign.chain, Announcement("h", 1, b"instance", 9, NOW))
    assert flood(candidates, rubbish, *addresses(500)) > 0
    heard(candidates, make(2), FAR)


def test_a_chain_is_verified_again_after_a_while(candidates: Candidates, make: Make) -> None:
    heard(candidates, make(1))
    ((identity, until),) = candidates._chains._entries.values()
    assert candidates.heard(make(2), NEAR, NOW, until + 1) is not None
    assert [later for _, later in candidates._chains._entries.values()] == [until + 1 + 60]
    assert identity.name == "/master"


def test_reasons_are_counted_and_bounded(candidates: Candidates) -> None:
    candidates.refused.update(f"reason {number}" for number in range(32))
    for _ in range(3):
        flood(candidates, b"x", FAR)
    assert len(candidates.refused) == 33
    assert candidates.refused["other reasons"] == 3


def test_candidates_are_bounded(candidates: Candidates, make: Make) -> None:
    for number in range(MAX_CANDIDATES):
        source = DatagramSource(f"fe80::{number}%near", 100 + number)
        assert candidates.heard(make(), source, NOW, float(number)) is not None
    with pytest.raises(AnnouncementRefused, match="more masters"):
        candidates.heard(make(), FAR, NOW, 100.0)


def test_the_memory_of_numbers_is_bounded(candidates: Candidates, make: Make) -> None:
    for seq in range(1100):
        assert candidates.heard(make(seq), NEAR, NOW, float(seq)) is not None
    assert len(candidates._seen) == 1024


def test_loss_is_counted_by_numbers_over_a_window(candidates: Candidates, make: Make) -> None:
    one = heard(candidates, make(0))
    for seq in range(2, 100, 2):
        candidates.heard(make(seq), NEAR, NOW, seq / 2)
    assert (len(one.heard), one.sent(49.0)) == (16, 31)
    assert one.loss(49.0) == pytest.approx(15 / 31)


def test_silence_is_loss(candidates: Candidates, make: Make) -> None:
    dead, alive = heard(candidates, make(0)), heard(candidates, make(0), FAR)
    for seq in range(1, 12):
        for source in (NEAR, FAR) if seq < 4 else (FAR,):
            candidates.heard(make(seq), source, NOW, 1 + seq / 2)
    candidates.probed(dead, ("h", 1), 0.001)
    candidates.probed(alive, ("h", 2), 0.1)
    assert dead.age(2.6) == pytest.approx(0.1)
    assert dead.loss(2.7) == 0.0
    assert dead.loss(3.2) == 0.0  # a little late is not lost
    assert dead.sent(6.5) == 11
    assert dead.loss(6.5) == pytest.approx(7 / 11)
    assert candidates.ranked(NOW, 6.5) == [alive, dead]


def test_a_single_announcement_is_not_lost_at_once(candidates: Candidates, make: Make) -> None:
    one = heard(candidates, make(0))
    assert [one.loss(at) for at in (1.0, 2.9, 4.1)] == [0.0, 0.0, 0.5]
