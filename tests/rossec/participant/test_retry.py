"""The pauses before reconnecting."""

import pytest

from rossec.participant.registrations import FAST_PERIOD, FIRST, Retry


@pytest.mark.parametrize("rand", [0.0, 0.5, 0.999])
def test_pauses_are_a_second_at_most_for_half_a_minute_and_then_five(rand: float) -> None:
    retry, now, pauses = Retry(lambda: rand), 1000.0, []
    while now < 1000 + 2 * FAST_PERIOD:
        pauses.append((now, retry.pause(now)))
        now += pauses[-1][1]
    factor = 1 - rand / 2
    assert pauses[0][1] == FIRST * factor
    assert [pause for at, pause in pauses if at < 1000 + FAST_PERIOD][2:] == pytest.approx(
        [factor] * (len([at for at, _ in pauses if at < 1000 + FAST_PERIOD]) - 2)
    )
    assert pauses[-1][1] == 5 * factor


def test_a_success_resets_the_pauses() -> None:
    retry = Retry(lambda: 0)
    assert [retry.pause(now) for now in (0.0, 40, 41, 42, 43, 44)] == [0.25, 0.5, 1, 2, 4, 5]
    retry.succeeded()
    assert [retry.pause(now) for now in (50.0, 51, 52, 53)] == [0.25, 0.5, 1, 1]
