"""Slow is allowed, endless is not."""

import pytest

from rossec.errors import LimitExceeded
from rossec.peer_limits import MAX_SECONDS, MIN_BYTES, STEP, WINDOW, Progress

NOW = 1_800_000_000


def lasts(unfinished: Progress, rate: int, most: int = 2 * MAX_SECONDS) -> int:
    """Seconds until it is given up, growing at `rate` bytes a second and looked at every second."""
    second = -1
    with pytest.raises(LimitExceeded) as caught:  # noqa: PT012 - when it comes is the question
        for second in range(most):
            unfinished.check(NOW + second, second * rate)
    assert f"after {second} seconds" in str(caught.value)
    assert "256 KiB of it a minute" in str(caught.value.hint)
    return second


def test_a_stalled_message_is_refused_after_a_window() -> None:
    assert lasts(Progress(), 0) == WINDOW
    unfinished = Progress()
    for second in range(100):
        unfinished.check(NOW + second, (second + 1) * 1024 * 1024)
    for second in range(100, 100 + WINDOW - 1):
        unfinished.check(NOW + second, 100 * 1024 * 1024)
    with pytest.raises(LimitExceeded):
        unfinished.check(NOW + 100 + WINDOW, 100 * 1024 * 1024)


def test_a_slow_message_is_accepted_up_to_the_maximum() -> None:
    assert lasts(Progress(), MIN_BYTES // WINDOW - 1) == WINDOW
    assert lasts(Progress(), MIN_BYTES // WINDOW + 100) == MAX_SECONDS
    assert lasts(Progress(), 1024 * 1024) == MAX_SECONDS


def test_a_complete_message_resets_the_progress() -> None:
    unfinished = Progress()
    assert unfinished.deadline is None
    for number in range(3):
        start = NOW + number * WINDOW
        for second in range(0, WINDOW - STEP, STEP):
            unfinished.check(start + second, 10)
            assert unfinished.deadline == start + second + STEP
        unfinished.done()
        assert unfinished.deadline is None


def test_only_the_time_of_reading_counts() -> None:
    """A reader that is elsewhere, a host that sleeps, a clock that is set."""
    unfinished = Progress()
    unfinished.check(NOW, 10)
    for second in range(10):
        unfinished.check(NOW + second * WINDOW, 10, reading=False)
    unfinished.check(NOW + 10**6, 10)
    unfinished.check(NOW - 10**6, 10)
    left = WINDOW - STEP
    for second in range(1, left):
        unfinished.check(NOW - 10**6 + second, 10)
    with pytest.raises(LimitExceeded):
        unfinished.check(NOW - 10**6 + left, 10)
