import pytest

from rossec.errors import RossecError
from rossec.gateway.rules import (
    FIRST_PAUSE,
    LINGER,
    LONGEST_PAUSE,
    TABLE,
    Action,
    GatewayEvent,
    GatewayPhase,
    TopicState,
)


def test_the_origin_is_subscribed_while_somebody_is_and_a_little_longer() -> None:
    state = TopicState()
    assert state.step(0, wanted=False) is Action.NOTHING
    assert state.step(1, wanted=True) is Action.SUBSCRIBE
    assert state.step(1, wanted=True) is Action.NOTHING
    assert state.step(10, wanted=False) is Action.NOTHING
    assert (state.phase, state.due) == (GatewayPhase.LINGERING, 10 + LINGER)
    assert state.step(12, wanted=True) is Action.NOTHING
    assert (state.phase, state.due) == (GatewayPhase.SUBSCRIBED, None)
    state.step(20, wanted=False)
    assert state.step(20 + LINGER - 0.1, wanted=False) is Action.NOTHING
    assert state.step(20 + LINGER, wanted=False) is Action.LEAVE
    assert (state.phase, state.due) == (GatewayPhase.IDLE, None)


def test_what_failed_is_left_and_tried_again_less_and_less_often() -> None:
    state, now, pauses = TopicState(), 0.0, []
    assert state.step(now, wanted=True) is Action.SUBSCRIBE
    for _ in range(6):
        assert state.failed(now) is Action.LEAVE
        assert state.due is not None
        pauses.append(state.due - now)
        assert state.step(now, wanted=True) is Action.NOTHING
        now = state.due
        assert state.step(now, wanted=True) is Action.SUBSCRIBE
    assert pauses == [FIRST_PAUSE, 2, 4, 8, LONGEST_PAUSE, LONGEST_PAUSE]
    state.connected()
    state.failed(now)
    assert state.due == now + FIRST_PAUSE


def test_what_nobody_wants_any_more_is_not_tried_again() -> None:
    state = TopicState()
    state.step(0, wanted=True)
    state.failed(0)
    assert state.step(0.1, wanted=False) is Action.NOTHING
    assert (state.phase, state.due) == (GatewayPhase.IDLE, None)
    state.step(1, wanted=True)
    state.step(1, wanted=False)
    assert state.failed(2) is Action.LEAVE
    assert state.phase is GatewayPhase.IDLE


def test_every_other_event_is_an_error() -> None:
    for phase in GatewayPhase:
        for event in GatewayEvent:
            if (phase, event) in TABLE:
                continue
            state = TopicState()
            state.phase = phase
            with pytest.raises(RossecError):
                state._enter(event, 0)
