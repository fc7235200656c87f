"""Turns end by the given clock, and work resumes where it was suspended."""

import pytest

from rossec.master.api.methods import TURN, CallOutcome, TurnClock, Work, advance
from tests.rossec.master.fakes import never_expires, run_to_end


def work(steps: int) -> Work:
    for _ in range(steps):
        yield
    return CallOutcome(steps)


def test_a_turn_ends_by_the_clock() -> None:
    now = [100.0]
    turns = TurnClock(lambda: now[0])
    expired = turns.begin()
    assert not expired()
    now[0] += TURN
    assert expired()
    assert not turns.begin()()


def test_work_resumes_where_it_was_suspended() -> None:
    left = work(3)
    assert [advance(left, lambda: True) for _ in range(4)] == [None, None, None, CallOutcome(3)]
    assert advance(work(3), never_expires) == CallOutcome(3)
    assert run_to_end(work(0)) == run_to_end(work(0)) == CallOutcome(0)


def test_an_exception_in_the_work_is_raised() -> None:
    def broken() -> Work:
        yield
        raise ValueError("no")

    left = broken()
    assert advance(left, lambda: True) is None
    with pytest.raises(ValueError, match="no"):
        advance(left, never_expires)
