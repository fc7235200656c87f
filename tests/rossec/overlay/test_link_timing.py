"""Round trips and the congestion window."""

import pytest

from rossec.overlay.link_sides import (
    FIRST_WINDOW,
    LEAST_WAIT,
    LEAST_WINDOW,
    MOST_WAIT,
    MOST_WINDOW,
    QUEUE,
    STEP,
    CongestionWindow,
    RoundTrip,
)


def test_the_round_trip_is_smoothed() -> None:
    trip = RoundTrip()
    trip.sample(0.08)
    assert trip.srtt_s == 0.08
    trip.sample(0.16)
    assert trip.srtt_s == pytest.approx(0.09)
    assert trip.least_s == 0.08
    trip.way_changed()
    assert trip.least_s == trip.srtt_s


@pytest.mark.parametrize(("srtt", "wait"), [(0.0, 0.2), (0.01, 0.2), (0.1, 0.4), (9.0, MOST_WAIT)])
def test_an_answer_may_take_four_round_trips(srtt: float, wait: float) -> None:
    trip = RoundTrip()
    trip.srtt_s = srtt
    assert trip.wait == pytest.approx(wait)


@pytest.mark.parametrize(
    ("srtt", "silence", "pause"),
    [(0.0, 0.0, LEAST_WAIT), (0.0, 4.0, 0.5), (0.5, 0.0, 1.0), (0.0, 29.0, MOST_WAIT)],
)
def test_who_is_silent_is_asked_more_and_more_seldom(srtt: float, silence: float, pause: float) -> None:
    trip = RoundTrip()
    trip.srtt_s = srtt
    assert trip.again(silence) == pytest.approx(pause)


def test_what_was_sent_again_is_judged_after_a_round_trip() -> None:
    trip = RoundTrip()
    assert trip.repeat == 0.01
    trip.srtt_s = 0.2
    assert trip.repeat == 0.25


def test_the_window_doubles_until_a_loss_and_then_grows_by_steps() -> None:
    window = CongestionWindow()
    assert window.size == FIRST_WINDOW
    window.acknowledged(FIRST_WINDOW, FIRST_WINDOW)
    assert window.size == 2 * FIRST_WINDOW
    window.lost(0, 100)
    assert window.size == FIRST_WINDOW
    window.acknowledged(FIRST_WINDOW, FIRST_WINDOW)
    assert window.size == FIRST_WINDOW + STEP


def test_losses_of_one_round_trip_halve_it_once() -> None:
    window = CongestionWindow()
    window.acknowledged(FIRST_WINDOW, FIRST_WINDOW)
    for offset in (0, 30, 99):
        window.lost(offset, 100)
    assert window.size == FIRST_WINDOW
    window.lost(100, 200)
    assert window.size == FIRST_WINDOW // 2


def test_the_window_has_bounds() -> None:
    window = CongestionWindow()
    for _ in range(100):
        window.acknowledged(window.size, window.size)
    assert window.size == MOST_WINDOW
    for offset in range(100):
        window.lost(offset, offset + 1)
    assert window.size == LEAST_WINDOW


def test_what_waits_in_queues_is_what_a_round_trip_takes_more_than_it_must() -> None:
    trip = RoundTrip()
    trip.sample(0.1)
    for _ in range(100):
        trip.sample(0.3)
    assert trip.queued_s == pytest.approx(0.2, abs=0.001)
    trip.way_changed()
    assert trip.queued_s == 0.0


def test_a_window_that_fills_queues_shrinks_by_a_quarter_each_round_trip() -> None:
    window = CongestionWindow()
    window.acknowledged(FIRST_WINDOW // 2, FIRST_WINDOW, 2 * QUEUE)
    assert window.size == FIRST_WINDOW
    window.acknowledged(FIRST_WINDOW // 2, FIRST_WINDOW, 2 * QUEUE)
    assert window.size == FIRST_WINDOW * 3 // 4
    for _ in range(100):
        window.acknowledged(FIRST_WINDOW, FIRST_WINDOW, 2 * QUEUE)
    assert window.size == LEAST_WINDOW
    window.acknowledged(LEAST_WINDOW, LEAST_WINDOW, QUEUE)
    assert window.size == 2 * LEAST_WINDOW


def test_a_window_that_is_not_used_does_not_grow() -> None:
    window = CongestionWindow()
    window.acknowledged(1000, FIRST_WINDOW // 4)
    assert window.size == FIRST_WINDOW
