"""Limits: rates exact in the long run, and slots that hide when something begins."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from grants.limits import RateBucket, SlotGate

NOW = 1_800_000_000
HOUR = 3600


def admitted(rate: float, times: list[float]) -> list[float]:
    """Which of the messages at these times pass."""
    bucket, passed = RateBucket(rate, rate + 1), []
    for now in times:
        if bucket.refill(now):
            bucket.charge(object())
            passed.append(now)
    return passed


@pytest.mark.parametrize(("rate", "tenths"), [(0.1, 100), (0.3, 34), (0.7, 15), (1 / 30, 300), (1, 10)])
def test_a_rate_is_exact_for_ten_messages_a_second(rate: float, tenths: int) -> None:
    """It was counted in whole seconds and as a sum of floats: 11, 4 and 2 s for the first three."""
    passed = admitted(rate, [NOW + n / 10 for n in range(10 * 90)])
    assert [round((now - NOW) * 10) for now in passed[:3]] == [0, tenths, 2 * tenths]


@given(rate=st.floats(0.01, 1000), gaps=st.lists(st.floats(0, 20), max_size=200))
def test_no_more_than_the_rate_and_one_burst(rate: float, gaps: list[float]) -> None:
    times, now = [], float(NOW)
    for gap in gaps:
        now += gap
        times.append(now)
    passed = admitted(rate, times)
    for first in range(0, len(passed), 7):
        spent = times[-1] - passed[first]
        assert len(passed) - first <= spent * rate + max(1, rate) + 1e-3


def test_a_rate_above_one_allows_a_burst_of_a_second() -> None:
    assert len(admitted(5, [NOW] * 20)) == 5
    assert len(admitted(2.5, [NOW] * 20)) == 2


@pytest.mark.parametrize("rate", [5e-324, 1e-300, 6e-300, 1e-12])
def test_the_smallest_rates_admit_one_message(rate: float) -> None:
    assert admitted(rate, [NOW, NOW + 1, NOW + 10**9]) == [NOW]


def test_a_clock_set_back_adds_nothing() -> None:
    assert admitted(1, [NOW, NOW - 50, NOW - 49.5, NOW - 49]) == [NOW, NOW - 49]


def test_charges_of_other_rates_leave_no_debt() -> None:
    bucket = RateBucket(0.1, 1)
    for _ in range(5):
        bucket.charge(object())
    assert (bucket.tokens, bucket.is_full(NOW)) == (0, False)
    assert not bucket.is_full(NOW + 9.9)
    assert bucket.is_full(NOW + 10)


def told(seconds: int, times: list[float]) -> list[float]:
    gate, passed = SlotGate(seconds), []
    for now in times:
        ready, message = gate.ready(now), object()
        assert ready is gate.note(message, now)
        if ready:
            gate.charge(message)
            passed.append(now)
    return passed


def test_one_message_in_the_beginning_of_each_slot() -> None:
    times = [NOW + n / 10 for n in range(250, 3000)]  # begins in the middle of a slot
    assert told(60, times) == [NOW + 60, NOW + 120, NOW + 180, NOW + 240]


def test_what_happens_once_is_not_told() -> None:
    for moment in (0, 0.5, 1.9, 2, 30, 59.9):
        assert told(60, [NOW + moment]) == []
    assert told(60, [NOW, NOW + 120]) == [], "the slot between them was empty"
    assert told(60, [NOW, NOW + 70]) == [], "not in the beginning of its slot"


@given(onset=st.floats(0, HOUR), length=st.floats(0, HOUR))
def test_beginning_and_end_are_told_to_a_slot(onset: float, length: float) -> None:
    """Whatever the moments: the same in a slot give the same."""
    ticks = range(round(onset * 10), round((onset + length) * 10))
    passed = told(60, [NOW + n / 10 for n in ticks])
    first, last = ticks.start // 600, (ticks.stop - 1) // 600
    assert [(now - NOW) // 60 for now in passed] == list(range(first + 1, last + 1))
    assert all((now - NOW) % 60 < 0.001 for now in passed)


def test_a_message_tried_again_is_no_other_message() -> None:
    """A latched one, for each new connection: else connecting would stand for what is published."""
    gate, latched = SlotGate(60), object()
    assert not gate.note(latched, NOW)
    assert not gate.note(latched, NOW + 60)
    assert not gate.note(object(), NOW + 120), "nothing was published in the slot before"
    again = object()
    assert gate.note(again, NOW + 180)
    gate.charge(again)
    assert gate.note(again, NOW + 180.5), "another connection of the same receiver"
    assert not gate.note(object(), NOW + 180.6)
    assert gate.note(again, NOW + 181)
    gate.charge(again)
    assert gate.note(object(), NOW + 240)


def test_a_gate_that_is_as_new() -> None:
    gate = SlotGate(60)
    assert gate.is_fresh(NOW)
    gate.note(object(), NOW)
    assert [gate.is_fresh(NOW + after) for after in (0, 60, 119, 120)] == [False] * 3 + [True]
    assert not gate.note(object(), NOW - 600), "a clock set back"


def test_a_clock_that_goes_back_over_a_border_opens_no_slot_again() -> None:
    """Each time it came back, one more message passed: a hundred within a hundredth of a second."""
    gate, border, passed = SlotGate(60), NOW // 60 * 60, 0
    assert not gate.note(object(), border - 30)
    for turn in range(100):
        message = object()
        if gate.note(message, border + (-0.01 if turn % 2 else 0.01)):
            gate.charge(message)
            passed += 1
        assert not gate.ready(border - 0.01)
    assert passed == 1
    after = object()
    assert gate.note(after, border + 60)
    assert not gate.note(object(), border - HOUR)
    assert gate.note(object(), border - HOUR + 60)
