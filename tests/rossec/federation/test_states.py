import pytest

from rossec.errors import RossecError
from rossec.federation.site_state import (
    LONGEST_PAUSE,
    LOST_FOR,
    TABLE,
    SiteEffect,
    SiteEvent,
    SitePhase,
    SiteState,
)


def followed() -> SiteState:
    state = SiteState()
    for event in (SiteEvent.DUE, SiteEvent.CONNECTED, SiteEvent.ANSWERED):
        assert state.take(event, 0.0) is SiteEffect.NONE
    assert state.phase is SitePhase.FOLLOWING
    return state


def test_a_lost_site_keeps_its_facts_for_a_minute() -> None:
    state = followed()
    assert state.take(SiteEvent.FAILED, 10.0) is SiteEffect.MARK
    assert state.phase is SitePhase.LOST
    for clock in (11.0, 13.0, 17.0):
        state.take(SiteEvent.DUE, clock)
        assert state.take(SiteEvent.FAILED, clock) is SiteEffect.MARK
    assert not state.has_expired(10.0 + LOST_FOR - 0.1)
    assert state.has_expired(10.0 + LOST_FOR), "the minute begins with the loss"
    assert state.take(SiteEvent.EXPIRED, 70.0) is SiteEffect.EXPIRE
    assert state.phase is SitePhase.LOST
    assert not state.has_expired(1000.0), "once"


def test_a_site_that_answers_again_is_no_longer_lost() -> None:
    state = followed()
    state.take(SiteEvent.FAILED, 10.0)
    for event in (SiteEvent.DUE, SiteEvent.CONNECTED, SiteEvent.ANSWERED):
        state.take(event, 60.0)
    assert not state.has_expired(1000.0)
    assert state.failures == 0


@pytest.mark.parametrize("reached", range(3))
def test_a_refusal_drops_the_facts_at_once(reached: int) -> None:
    state = SiteState()
    for event in (SiteEvent.DUE, SiteEvent.CONNECTED, SiteEvent.ANSWERED)[: reached + 1]:
        state.take(event, 0.0)
    assert state.take(SiteEvent.REFUSED, 1.0) is SiteEffect.DROP
    assert state.phase is SitePhase.IDLE
    assert state.take(SiteEvent.DUE, 2.0) is SiteEffect.NONE, "it is tried again: rights may be given"


@pytest.mark.parametrize("reached", [2, 3])
def test_a_site_that_shows_nothing_is_listened_to(reached: int) -> None:
    state = SiteState()
    for event in (SiteEvent.DUE, SiteEvent.CONNECTED, SiteEvent.ANSWERED)[:reached]:
        state.take(event, 0.0)
    state.failures = 3
    assert state.take(SiteEvent.HIDDEN, 1.0) is SiteEffect.DROP
    assert (state.phase, state.failures) == (SitePhase.LISTENING, 0)
    assert state.take(SiteEvent.FAILED, 2.0) is SiteEffect.MARK
    assert not state.has_expired(1000.0), "there are no facts"
    state.phase = SitePhase.LISTENING
    assert state.take(SiteEvent.DUE, 3.0) is SiteEffect.NONE, "there is a grant now"


@pytest.mark.parametrize("phase", list(SitePhase))
def test_removal_drops_the_facts_whatever_the_phase(phase: SitePhase) -> None:
    state = SiteState()
    state.phase = phase
    assert state.take(SiteEvent.REMOVED, 0.0) is SiteEffect.DROP
    assert state.phase is SitePhase.IDLE


def test_what_is_not_in_the_table_is_an_error() -> None:
    refused = 0
    for phase in SitePhase:
        for event in SiteEvent:
            state = SiteState()
            state.phase = phase
            if (phase, event) in TABLE:
                state.take(event, 0.0)
                continue
            with pytest.raises(RossecError, match=phase.value):
                state.take(event, 0.0)
            refused += 1
    assert refused == len(SitePhase) * len(SiteEvent) - len(TABLE)


def test_pauses_grow_to_half_a_minute_and_are_spread() -> None:
    state = SiteState()
    pauses = []
    for _ in range(8):
        state.take(SiteEvent.DUE, 0.0)
        state.take(SiteEvent.FAILED, 0.0)
        pauses.append(state.pause(0.5))
    assert pauses == [1, 2, 4, 8, 16, LONGEST_PAUSE, LONGEST_PAUSE, LONGEST_PAUSE]
    assert state.pause(0.0) == pytest.approx(0.8 * LONGEST_PAUSE)
    assert state.pause(0.999) == pytest.approx(1.2 * LONGEST_PAUSE, rel=0.01)
    state.failures = 10_000
    assert state.pause(0.5) == LONGEST_PAUSE
