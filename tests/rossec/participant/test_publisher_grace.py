"""Whom to follow while a master learns anew who there is."""

import time
from pathlib import Path

import pytest

from rossec import clock
from rossec.clock import Clock
from rossec.participant.publisher_grace import GRACE, PublisherGrace
from tests.support.site import Site

A, B, C = "http://a/", "http://b/", "http://c/"
T, U = "/t", "/u"


class Told:
    """What a node's master tells it, at given times."""

    def __init__(self) -> None:
        self.now = 100.0
        self.named = PublisherGrace(lambda: self.now)
        assert self.named.update(T, [A, B]) == [A, B]


@pytest.fixture
def told() -> Told:
    return Told()


def test_the_list_of_the_master_is_used_without_a_loss(told: Told) -> None:
    assert told.named.update(T, [B]) == [B]
    assert told.named.update(T, []) == []
    assert told.named.expired_topics() == []
    assert told.named.to_follow("/unknown") == []


def test_missing_publishers_are_kept_after_a_loss(told: Told) -> None:
    told.named.session_opened()
    assert told.named.update(T, []) == [A, B]
    assert told.named.update(T, [C]) == [C, A, B]
    assert told.named.update(T, [C, B]) == [C, B, A]
    told.now += GRACE - 0.1
    assert told.named.to_follow(T) == [C, B, A]
    assert told.named.expired_topics() == []
    told.now += 0.1
    assert told.named.to_follow(T) == [C, B]
    assert (told.named.expired_topics(), told.named.expired_topics()) == ([T], [])


def test_a_publisher_listed_again_and_removed_is_dropped_at_once(told: Told) -> None:
    told.named.session_opened()
    assert told.named.update(T, [A]) == [A, B]
    assert told.named.update(T, []) == [B]
    assert told.named.update(T, [B]) == [B]
    assert told.named.update(T, []) == []
    told.now += GRACE
    assert told.named.expired_topics() == [], "nobody was missing"


def test_repeated_losses_do_not_extend_the_grace_period(told: Told) -> None:
    """The time began with the first loss."""
    for _ in range(5):
        told.named.session_opened()
        assert told.named.update(T, [A]) == [A, B]
        told.now += GRACE / 5
    told.named.session_opened()
    assert told.named.update(T, []) == [A]
    assert told.named.update(T, [A]) == [A]


def test_a_loss_after_a_complete_list_begins_a_new_grace_period(told: Told) -> None:
    told.named.session_opened()
    told.now += GRACE - 1
    assert told.named.update(T, [A, B]) == [A, B]
    told.named.session_opened()
    assert told.named.update(T, []) == [A, B]
    told.now += GRACE - 1
    assert told.named.to_follow(T) == [A, B]


def test_a_complete_topic_does_not_extend_the_grace_period_of_another(told: Told) -> None:
    told.named.update(U, [C])
    told.named.session_opened()
    assert told.named.update(U, [C]) == [C]
    told.now += GRACE - 1
    told.named.session_opened()
    assert (told.named.update(T, []), told.named.update(U, [])) == ([A, B], [C])
    told.now += 1
    assert (told.named.to_follow(T), told.named.to_follow(U)) == ([], [])
    assert told.named.expired_topics() == [T, U]


def test_a_topic_without_subscribers_is_forgotten(told: Told) -> None:
    told.named.session_opened()
    told.named.forget(T)
    assert told.named.to_follow(T) == []
    assert told.named.update(T, [C]) == [C]
    told.now += GRACE
    assert told.named.expired_topics() == []


async def test_the_grace_period_does_not_depend_on_the_corrected_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clock that was an hour ahead would otherwise keep publishers for an hour."""
    ahead = [3600.0]
    monkeypatch.setattr(clock, "HOST", Clock(lambda: time.time() + ahead[0]))
    async with Site(tmp_path / "site").running() as site, site.node("/viewer") as viewer:
        now = viewer._topics._grace._now
        before = now()
        ahead[0] = 0.0
        assert clock.correct(int(time.time()))
        assert now() >= before
