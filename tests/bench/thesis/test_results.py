"""Figures from times, without a network."""

import pytest

from bench.thesis.results import Measured, copies, growth, largest, measured, quantile
from bench.thesis.talk import Point


def point(size: int = 100, count: int = 4) -> Point:
    return Point(size, 1.0, count)


def row(size: int, *, arrived: float = 1.0, rate: float = 1.0, rises: float = 0.0) -> Measured:
    return Measured(size, rate, 5, 1, 9, 8, arrived, rises)


def test_latency_is_of_every_message_at_every_receiver() -> None:
    sent = [10.0, 11.0]
    found = measured(point(count=2), sent, [{0: 10.001, 1: 11.003}, {0: 10.005, 1: 11.007}])
    assert (found.mean, found.low, found.high, found.last) == (4, 1, 7, 6)
    assert (found.arrived, found.holds, found.spread) == (1, True, 6)


def test_the_span_holds_96_percent() -> None:
    sent = [0.0] * 101
    found = measured(point(count=101), sent, [{n: n / 1000 for n in range(101)}])
    assert (found.low, found.high) == (2, 98)


def test_a_point_holds_with_one_message_of_a_hundred_lost_and_not_with_two() -> None:
    sent = [float(n) for n in range(100)]
    receivers = [{n: n + 0.01 for n in range(count)} for count in (99, 98)]
    assert measured(point(count=100), sent, receivers[:1]).holds
    assert not measured(point(count=100), sent, receivers[1:]).holds


def test_a_queue_that_grows_does_not_hold_though_all_arrive() -> None:
    sent = [0.0, 1.0, 2.0, 3.0]
    found = measured(point(), sent, [{n: n + 0.1 + 0.2 * n for n in range(4)}])
    assert found.growth == pytest.approx(0.2)
    assert found.arrived == 1
    assert not found.holds


def test_nothing_that_arrives_does_not_hold() -> None:
    assert not measured(point(), [0.0, 1.0], [{}, {}]).holds


def test_who_lacks_a_message_does_not_count_for_the_last_receiver() -> None:
    found = measured(point(count=2), [0.0, 1.0], [{0: 0.002, 1: 1.002}, {0: 0.004}])
    assert (found.last, found.arrived) == (4, 0.75)


def test_growth_of_a_single_message_is_none() -> None:
    assert growth([(1.0, 0.3)]) == 0


def test_quantiles_of_a_single_value() -> None:
    assert quantile([7.0], 0.02) == quantile([7.0], 0.98) == 7


def test_the_largest_size_is_below_the_first_that_does_not_hold() -> None:
    rows = [row(100), row(1000), row(5000, arrived=0.5), row(10_000)]
    assert largest(rows) == 1000
    assert largest([row(5000, rises=0.5)]) == 0


def test_the_largest_size_is_that_of_its_rate() -> None:
    assert largest([row(100), row(9000, rate=10)]) == 100


def test_copies_are_bytes_on_the_link_in_messages() -> None:
    assert copies(13_000, Point(1000, 1.0, 2)) == 6.5


def test_json_says_whether_a_point_holds() -> None:
    assert row(100).as_json()["holds"] is True
    assert row(100).as_json()["mean"] == 5
