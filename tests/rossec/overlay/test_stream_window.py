"""Windows grow for who takes what arrives, shrink for who does not, and share what a link has."""

from collections import deque
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.overlay.mux import (
    BUDGET,
    FIRST,
    MAX_DATA,
    MOST,
    NODE,
    SHORTEST_ROUND,
    Mux,
    ReceiveWindow,
    Role,
    StreamTarget,
    WindowBudget,
)

ROUND_TRIP = 0.1
TICK = 0.001
Taker = Callable[[float], float]
"""Bytes in a second that a program takes, by the time."""


def always(_: float) -> float:
    return 1e12


def after(start: float, rate: float) -> Taker:
    return lambda now: rate if now >= start else 0


class Line:
    """A sender with no end of bytes, and a way of so many bytes a second, in simulated time."""

    def __init__(self, rate: float, takes: Taker, budget: WindowBudget | None = None) -> None:
        self.window = ReceiveWindow(budget or WindowBudget())
        self.now = 100.0
        self.taken = self.highest = self.longest_queue = 0
        self._takes = takes
        self._rate = rate
        self._credit = float(FIRST)
        self._queue = 0.0
        self._on_the_way: deque[tuple[float, float]] = deque()
        self._back: deque[tuple[float, int]] = deque()

    def run(self, seconds: float) -> int:
        """How many bytes the program took meanwhile."""
        before, end = self.taken, self.now + seconds
        while self.now < end:
            self.now += TICK
            self._send()
            self._receive()
        return self.taken - before

    def _send(self) -> None:
        while self._back and self._back[0][0] <= self.now:
            self._credit += self._back.popleft()[1]
        self._queue += self._credit
        self._credit = 0
        self.longest_queue = max(self.longest_queue, int(self._queue))
        count = int(min(self._queue, self._rate * TICK))
        self._queue -= count
        if count:
            self._on_the_way.append((self.now + ROUND_TRIP / 2, count))

    def _receive(self) -> None:
        window = self.window
        while self._on_the_way and self._on_the_way[0][0] <= self.now:
            window.arrived(int(self._on_the_way.popleft()[1]))
        assert window.allowed >= 0
        assert window.allowed + window.held <= window.size
        count = int(min(window.held, self._takes(self.now - 100) * TICK))
        if count:
            self.taken += count
            credit = window.took(count, self.now, ROUND_TRIP)
            if credit:
                self._back.append((self.now + ROUND_TRIP / 2, credit))
        self.highest = max(self.highest, window.size)


@pytest.mark.parametrize("rate", [5e6, 10e6, 18e6])
def test_a_window_grows_to_what_the_way_carries_and_not_by_its_own_queue(rate: float) -> None:
    line = Line(rate, always)
    line.run(2)
    assert line.run(5) > 0.95 * 5 * rate
    assert line.highest <= 2.2 * rate * ROUND_TRIP, "twice what is on the way at best"
    assert line.longest_queue <= 1.3 * rate * ROUND_TRIP


def test_a_window_is_at_most_that_of_a_link() -> None:
    line = Line(1e9, always)
    line.run(3)
    assert line.highest == MOST
    assert line.run(5) > 0.7 * 5 * MOST / ROUND_TRIP


def test_a_way_that_needs_no_more_keeps_the_first_window() -> None:
    line = Line(1e6, always)
    line.run(5)
    assert line.highest == FIRST


@pytest.mark.parametrize("rate", [0.0, 1e5, 1e6])
def test_a_program_that_lags_from_the_start_keeps_the_first_window(rate: float) -> None:
    line = Line(50e6, after(0, rate))
    line.run(20)
    assert line.highest == FIRST


def test_a_program_that_begins_to_lag_gets_no_credit_until_its_window_is_small() -> None:
    line = Line(50e6, lambda now: 1e12 if now < 3 else 2e5)
    line.run(3)
    assert line.window.size == MOST
    line.run(1)
    assert line.window.held <= MOST
    line.run(25)
    assert line.window.size == FIRST
    assert line.window.held <= FIRST


def test_a_window_grows_again_after_a_pause() -> None:
    line = Line(20e6, lambda now: 0 if 3 < now < 30 else 1e12)
    line.run(32)
    assert line.run(3) > 0.9 * 3 * 20e6


def test_windows_share_the_fund_and_return_it() -> None:
    budget = WindowBudget(MOST)
    first, second = Line(100e6, always, budget), Line(100e6, always, budget)
    first.run(3)
    second.run(3)
    assert (first.window.size, second.window.size) == (MOST, FIRST + FIRST)
    assert budget.left == 0
    first.window.close()
    second.run(3)
    assert second.window.size == MOST
    second.window.close()
    assert budget.left == MOST


def test_a_stream_that_is_over_returns_what_its_window_had() -> None:
    """As many streams as the budget has large windows for, one after the other, and one more."""
    caller, called = Mux(Role.CALLER), Mux(Role.CALLED)
    for number in range(BUDGET // (MOST - FIRST) + 2):
        called.receive(caller.open(StreamTarget(NODE, "/robot"), number)[1], number)
        for unit in range(300):
            called.receive(caller.data(number, MAX_DATA) + bytes(MAX_DATA), number)
            credit = called.took(number, MAX_DATA, number + unit / 500, 0.1)
            caller.receive(credit, number)
        assert caller.credit(number) > MOST // 2
        called.receive(caller.reset(number), number)


def test_without_a_round_trip_windows_stay_as_they_are() -> None:
    window = ReceiveWindow(WindowBudget())
    for number in range(1, 1000):
        window.arrived(FIRST)
        assert window.took(FIRST, number * 1e-6, 0.0) == FIRST
    assert window.size == FIRST


def test_a_round_is_not_shorter_than_programs_need_to_take_turns() -> None:
    window = ReceiveWindow(WindowBudget())
    sizes = []
    for number in range(4):
        window.arrived(FIRST)
        window.took(FIRST, 1 + number * SHORTEST_ROUND / 2.5, 1e-6)
        sizes.append(window.size)
    assert sizes[:3] == [FIRST] * 3, "no round has begun and ended yet"
    assert window.size == 2 * FIRST


def test_more_than_arrived_cannot_be_taken() -> None:
    window = ReceiveWindow(WindowBudget())
    window.arrived(10)
    with pytest.raises(ValueError, match="more was taken than arrived"):
        window.took(11, 0, 0)


STEPS = st.lists(
    st.tuples(st.integers(0, 9), st.floats(0, 1), st.floats(0, 1), st.floats(0, 0.5)), max_size=200
)


@given(steps=STEPS, round_trip_s=st.floats(0, 1))
def test_no_order_of_events_gives_more_than_the_windows(
    steps: list[tuple[int, float, float, float]], round_trip_s: float
) -> None:
    """`allowed` is what the peer was told; what may be kept is first windows and the budget."""
    budget = WindowBudget(5 * FIRST)
    windows = [ReceiveWindow(budget) for _ in range(10)]
    told = [FIRST] * 10
    now = 0.0
    for which, sent, taken, pause in steps:
        now += pause
        window = windows[which]
        count = int(window.allowed * sent)
        told[which] -= count
        window.arrived(count)
        told[which] += window.took(int(window.held * taken), now, round_trip_s)
        assert told[which] == window.allowed
        assert 0 <= window.allowed + window.held <= window.size <= MOST
        assert window.size >= FIRST
        assert sum(each.size - FIRST for each in windows) == 5 * FIRST - budget.left <= 5 * FIRST


def test_the_fund_of_a_link() -> None:
    assert WindowBudget().left == BUDGET == 8 * MOST
