"""Which publishers to keep while a restarted master receives registrations."""

import time
from pathlib import Path

import pytest

from rossec import clock
from rossec.clock import Clock
from rossec.participant.registrations import GRACE, PublisherGrace
from tests.support.site import Site

A, B, C = "http://a/", "http://b/", "http://c/"
T, U = "/t", "/u"


class MasterLists:
    """The publisher lists a master sends, at given times."""

    def __init__(self) -> None:
        self.now = 100.0
        self.grace = PublisherGrace(lambda: self.now)
        assert self.grace.update(T, [A, B]) == [A, B]


@pytest.fixture
def lists() -> MasterLists:
    return MasterLists()


def test_the_list_of_the_master_is_used_without_a_loss(lists: MasterLists) -> None:
    assert lists.grace.update(T, [B]) == [B]
    assert lists.grace.update(T, []) == []
    assert lists.grace.expired_topics() == []
    assert lists.grace.to_follow("/unknown") == []


def test_missing_publishers_are_kept_after_a_loss(lists: MasterLists) -> None:
    lists.grace.session_opened()
    assert lists.grace.update(T, []) == [A, B]
    assert lists.grace.update(T, [C]) == [C, A, B]
    assert lists.grace.update(T, [C, B]) == [C, B, A]
    lists.now += GRACE - 0.1
    assert lists.grace.to_follow(T) == [C, B, A]
    assert lists.grace.expired_topics() == []
    lists.now += 0.1
    assert lists.grace.to_follow(T) == [C, B]
    assert (lists.grace.expired_topics(), lists.grace.expired_topics()) == ([T], [])


def test_a_publisher_listed_again_and_removed_is_dropped_at_once(lists: MasterLists) -> None:
    lists.grace.session_opened()
    assert lists.grace.update(T, [A]) == [A, B]
    assert lists.grace.update(T, []) == [B]
    assert lists.grace.update(T, [B]) == [B]
    assert lists.grace.update(T, []) == []
    lists.now += GRACE
    assert lists.grace.expired_topics() == [], "no publisher was missing"


def test_repeated_losses_do_not_extend_the_grace_period(lists: MasterLists) -> None:
    """It began with the first loss."""
    for _ in range(5):
        lists.grace.session_opened()
        assert lists.grace.update(T, [A]) == [A, B]
        lists.now += GRACE / 5
    lists.grace.session_opened()
    assert lists.grace.update(T, []) == [A]
    assert lists.grace.update(T, [A]) == [A]


def test_a_loss_after_a_complete_list_begins_a_new_grace_period(lists: MasterLists) -> None:
    lists.grace.session_opened()
    lists.now += GRACE - 1
    assert lists.grace.update(T, [A, B]) == [A, B]
    lists.grace.session_opened()
    assert lists.grace.update(T, []) == [A, B]
    lists.now += GRACE - 1
    assert lists.grace.to_follow(T) == [A, B]


def test_a_complete_topic_does_not_extend_the_grace_period_of_another(lists: MasterLists) -> None:
    lists.grace.update(U, [C])
    lists.grace.session_opened()
    assert lists.grace.update(U, [C]) == [C]
    lists.now += GRACE - 1
    lists.grace.session_opened()
    assert (lists.grace.update(T, []), lists.grace.update(U, [])) == ([A, B], [C])
    lists.now += 1
    assert (lists.grace.to_follow(T), lists.grace.to_follow(U)) == ([], [])
    assert lists.grace.expired_topics() == [T, U]


def test_a_topic_without_subscribers_is_forgotten(lists: MasterLists) -> None:
    lists.grace.session_opened()
    lists.grace.forget(T)
    assert lists.grace.to_follow(T) == []
    assert lists.grace.update(T, [C]) == [C]
    lists.now += GRACE
    assert lists.grace.expired_topics() == []


async def test_the_grace_period_does_not_depend_on_the_corrected_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clock that was an hour ahead would otherwise keep publishers for an hour."""
    ahead = [3600.0]
    monkeypatch.setattr(clock, "HOST", Clock(lambda: time.time() + ahead[0]))
    async with Site(tmp_path / "site").running() as site, site.node("/viewer") as viewer:
        now = viewer.topics._grace._now
        before = now()
        ahead[0] = 0.0
        assert clock.correct(int(time.time()))
        assert now() >= before
