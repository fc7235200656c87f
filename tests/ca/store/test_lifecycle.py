import itertools

import pytest

from ca.errors import StoreError
from ca.store.values import DAY, OPEN, RETENTION, TRANSITIONS, RequestRow, RequestState, advance

NOW = 1_800_000_000
WAYS = {
    (RequestState.PENDING, RequestState.APPROVED),
    (RequestState.PENDING, RequestState.DENIED),
    (RequestState.APPROVED, RequestState.ISSUED),
    (RequestState.APPROVED, RequestState.DENIED),
}


def row(state: RequestState = RequestState.PENDING) -> RequestRow:
    return RequestRow(b"d" * 32, "/a", b"k" * 32, b"der", "test", NOW, state, "", NOW)


def test_every_state_has_its_ways_and_its_end() -> None:
    assert set(TRANSITIONS) == set(RETENTION) == set(RequestState)
    assert {RequestState.PENDING, RequestState.APPROVED} == OPEN
    assert {(a, b) for a, following in TRANSITIONS.items() for b in following} == WAYS


@pytest.mark.parametrize(("old", "new"), sorted(WAYS))
def test_the_ways_there_are(old: RequestState, new: RequestState) -> None:
    moved = advance(row(old), new, NOW + 5, "because")
    assert (moved.state, moved.changed, moved.reason) == (new, NOW + 5, "because")
    assert (moved.digest, moved.arrived) == (b"d" * 32, NOW)


@pytest.mark.parametrize(("old", "new"), sorted(set(itertools.product(RequestState, RequestState)) - WAYS))
def test_other_transitions_are_refused(old: RequestState, new: RequestState) -> None:
    with pytest.raises(StoreError, match=f"the request of /a is {old} and cannot be {new}"):
        advance(row(old), new, NOW)


@pytest.mark.parametrize("state", sorted(OPEN))
def test_a_request_expires(state: RequestState) -> None:
    assert row(state).expires == NOW + DAY
    advance(row(state), RequestState.DENIED, NOW + DAY)
    with pytest.raises(StoreError, match=f"was {state} for too long and has expired"):
        advance(row(state), RequestState.DENIED, NOW + DAY + 1)
