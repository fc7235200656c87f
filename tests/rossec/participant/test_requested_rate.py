"""A rate on average, and two messages at once at most."""

import pytest

from rossec.participant.delivery_options import RequestedRate


def admitted(rate: float, every: float, seconds: float) -> int:
    """How many messages pass that come at this interval."""
    requested = RequestedRate(rate)
    return sum(requested.admits(number * every) for number in range(round(seconds / every)))


@pytest.mark.parametrize(("rate", "every"), [(2, 0.1), (3, 0.1), (0.5, 0.033), (7, 0.001)])
def test_a_fast_publisher_is_thinned_out_to_the_rate(rate: float, every: float) -> None:
    assert admitted(rate, every, 60) == pytest.approx(rate * 60, abs=3)


@pytest.mark.parametrize("every", [0.1, 0.5, 3])
def test_a_publisher_that_is_no_faster_is_not_thinned_out(every: float) -> None:
    assert admitted(1 / every, every, 30) == round(30 / every)


def test_a_message_a_moment_early_costs_no_interval() -> None:
    requested = RequestedRate(10)
    times = [number * 0.1 + (0.02 if number % 2 else 0) for number in range(100)]
    assert all(map(requested.admits, times))


def test_after_a_pause_two_pass_at_once() -> None:
    requested = RequestedRate(1)
    assert [requested.admits(0) for _ in range(4)] == [True, True, False, False]
    assert [requested.admits(100) for _ in range(4)] == [True, True, False, False]


def test_a_clock_that_stands_admits_no_more() -> None:
    requested = RequestedRate(1000)
    assert sum(requested.admits(5) for _ in range(100)) == 2
