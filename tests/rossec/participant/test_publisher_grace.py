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
        assert self.named.are(T, [A, B]) == [A, B]


@pytest.fixture
def told() -> Told:
    return Told()


def test_without_a_loss_the_master_is_believed(told: Told) -> None:
    assert told.named.are(T, [B]) == [B]
    assert told.named.are(T, []) == []
    assert told.named.overdue() == []
    assert told.named.to_follow("/unknown") == []


def test_after_a_loss_those_who_are_missing_are_followed(told: Told) -> None:
    told.named.session_opened()
    assert told.named.are(T, []) == [A, B]
    assert told.named.are(T, [C]) == [C, A, B]
    assert told.named.are(T, [C, B]) == [C, B, A]
    told.now += GRACE - 0.1
    assert told.named.to_follow(T) == [C, B, A]
    assert told.named.overdue() == []
    told.now += 0.1
    assert told.named.to_follow(T) == [C, B]
    assert (told.named.overdue(), told.named.overdue()) == ([T], [])


def test_who_was_named_again_and_is_taken_away_is_gone_at_once(told: Told) -> None:
    told.named.session_opened()
    assert told.named.are(T, [A]) == [A, B]
    assert told.named.are(T, []) == [B]
    assert told.named.are(T, [B]) == [B]
    assert told.named.are(T, []) == []
    told.now += GRACE
    assert told.named.overdue() == [], "nobody was missing"


def test_whoever_resets_sessions_keeps_nobody_alive(told: Told) -> None:
    """The time began with the first loss."""
    for _ in range(5):
        told.named.session_opened()
        assert told.named.are(T, [A]) == [A, B]
        told.now += GRACE / 5
    told.named.session_opened()
    assert told.named.are(T, []) == [A]
    assert told.named.are(T, [A]) == [A]


def test_after_a_complete_list_a_loss_is_a_new_one(told: Told) -> None:
    told.named.session_opened()
    told.now += GRACE - 1
    assert told.named.are(T, [A, B]) == [A, B]
    told.named.session_opened()
    assert told.named.are(T, []) == [A, B]
    told.now += GRACE - 1
    assert told.named.to_follow(T) == [A, B]


def test_one_topic_that_is_complete_does_not_begin_the_time_of_another_anew(told: Told) -> None:
    told.named.are(U, [C])
    told.named.session_opened()
    assert told.named.are(U, [C]) == [C]
    told.now += GRACE - 1
    told.named.session_opened()
    assert (told.named.are(T, []), told.named.are(U, [])) == ([A, B], [C])
    told.now += 1
    assert (told.named.to_follow(T), told.named.to_follow(U)) == ([], [])
    assert told.named.overdue() == [T, U]


def test_a_topic_that_nobody_subscribes_to_is_forgotten(told: Told) -> None:
    told.named.session_opened()
    told.named.forget(T)
    assert told.named.to_follow(T) == []
    assert told.named.are(T, [C]) == [C]
    told.now += GRACE
    assert told.named.overdue() == []


async def test_its_time_goes_on_when_a_clock_is_put_right(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clock that was an hour ahead would otherwise keep publishers for an hour."""
    ahead = [3600.0]
    monkeypatch.setattr(clock, "HOST", Clock(lambda: time.time() + ahead[0]))
    async with Site(tmp_path / "site").running() as site, site.node("/viewer") as viewer:
        now = viewer._topics._named._now
        before = now()
        ahead[0] = 0.0
        assert clock.heard(int(time.time()))
        assert now() >= before
