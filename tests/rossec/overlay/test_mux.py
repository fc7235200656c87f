"""Streams as numbers, credit and limits: both sides agree, and no peer gets beyond its limits."""

import pytest

from rossec.errors import StreamRefused
from rossec.overlay.mux import FIRST as WINDOW
from rossec.overlay.mux import (
    FOR_ONE_NAME,
    LAST_STREAM,
    MAX_DATA,
    MOST,
    NODE,
    SERVICE,
    STREAMS,
    YOUNG,
    YOUNG_SECONDS,
    Credit,
    Data,
    End,
    Mux,
    OpeningRefused,
    Reset,
    Role,
    StreamOpened,
    StreamTarget,
    credit_unit,
    data_head,
    end_unit,
    open_unit,
    reset_unit,
)

ROBOT = StreamTarget(NODE, "/robot")


def pair() -> tuple[Mux, Mux]:
    return Mux(Role.CALLER), Mux(Role.CALLED)


def opened(now: float = 0.0) -> tuple[Mux, Mux]:
    """Both sides, with stream 0 open."""
    caller, called = pair()
    number, unit = caller.open(ROBOT, now)
    assert number == 0
    assert called.receive(unit, now) == [StreamOpened(0, ROBOT)]
    return caller, called


def data(mux: Mux, stream: int, payload: bytes) -> bytes:
    return mux.data(stream, len(payload)) + payload


def fill(called: Mux, count: int, now: float = 0.0, first: int = 0) -> list[object]:
    """Open as many streams as a caller that keeps no limit, each to a target of its own."""
    return [
        event
        for number in range(first, first + count)
        for event in called.receive(open_unit(number, StreamTarget(NODE, f"/n{number}")), now)
    ]


def test_a_stream_from_its_opening_to_its_end() -> None:
    caller, called = opened()
    assert called.receive(data(caller, 0, b"question"), 1) == [Data(0, memoryview(b"question"))]
    assert called.receive(caller.end(0), 1) == [End(0)]
    assert caller.credit(0) == 0
    assert caller.end(0) == b""
    assert caller.receive(data(called, 0, b"answer"), 2) == [Data(0, memoryview(b"answer"))]
    assert (0 in caller, 0 in called) == (True, True)
    assert caller.receive(called.end(0), 2) == [End(0)]
    assert (len(caller), len(called)) == (0, 0)
    assert caller.end(0) == caller.reset(0) == caller.took(0, 8) == b""


def test_a_stream_is_broken_off_by_either_side() -> None:
    for near, far in (opened(), opened()[::-1]):
        assert far.receive(near.reset(0), 0) == [Reset(0)]
        assert (len(near), len(far)) == (0, 0)


def test_units_of_a_stream_that_is_over_are_ignored() -> None:
    """They were on their way when it was broken off."""
    caller, called = opened()
    late = data(called, 0, b"late") + credit_unit(0, 5) + called.end(0)
    caller.reset(0)
    assert caller.receive(late, 0) == []
    assert caller.receive(reset_unit(0), 0) == []


def test_credit_is_spent_and_given_back_in_quarters() -> None:
    caller, called = opened()
    for size in (MAX_DATA, MAX_DATA, MAX_DATA, MAX_DATA, WINDOW - 4 * MAX_DATA):
        called.receive(data(caller, 0, bytes(size)), 0)
    assert caller.credit(0) == 0
    with pytest.raises(StreamRefused, match="beyond the credit"):
        caller.data(0, 1)
    assert called.took(0, WINDOW // 4 - 1) == b""
    unit = called.took(0, 1)
    assert caller.receive(unit, 0) == [Credit(0, WINDOW // 4)]
    assert caller.credit(0) == WINDOW // 4
    caller.end(0)
    assert caller.receive(called.took(0, WINDOW * 3 // 4), 0) == [Credit(0, WINDOW * 3 // 4)]
    assert caller.credit(0) == 0


def test_no_credit_is_given_after_the_end() -> None:
    caller, called = opened()
    called.receive(caller.end(0), 0)
    assert called.took(0, WINDOW) == b""


def test_a_peer_may_give_more_credit_up_to_a_link() -> None:
    caller, _ = opened()
    caller.receive(credit_unit(0, MOST - WINDOW), 0)
    assert caller.credit(0) == MOST
    with pytest.raises(StreamRefused, match="credit for stream 0 beyond"):
        caller.receive(credit_unit(0, 1), 0)


@pytest.mark.parametrize(
    "unit",
    [
        open_unit(0, ROBOT),
        open_unit(2, ROBOT),
        data_head(1, 1) + b"x",
        credit_unit(1, 1),
        end_unit(1),
        reset_unit(1),
        end_unit(0) * 2,
        end_unit(0) + data_head(0, 1) + b"x",
    ],
    ids=[
        "a number again",
        "a number left out",
        "data before the opening",
        "credit",
        "end",
        "reset",
        "two ends",
        "data after the end",
    ],
)
def test_the_caller_may_not(unit: bytes) -> None:
    _, called = opened()
    with pytest.raises(StreamRefused):
        called.receive(unit, 0)


def test_the_caller_may_not_send_beyond_its_credit() -> None:
    _, called = opened()
    for _ in range(WINDOW // MAX_DATA):
        called.receive(data_head(0, MAX_DATA) + bytes(MAX_DATA), 0)
    with pytest.raises(StreamRefused, match="beyond its credit"):
        called.receive(data_head(0, MAX_DATA) + bytes(MAX_DATA), 0)


@pytest.mark.parametrize("unit", [open_unit(1, ROBOT), data_head(1, 1) + b"x"], ids=["open", "data"])
def test_the_called_side_may_not(unit: bytes) -> None:
    caller, _ = opened()
    with pytest.raises(StreamRefused):
        caller.receive(unit, 0)


def test_only_the_caller_opens() -> None:
    with pytest.raises(StreamRefused, match="only the caller"):
        Mux(Role.CALLED).open(ROBOT, 0)


def test_new_streams_are_few_until_they_grow_old_or_end() -> None:
    called = Mux(Role.CALLED)
    assert all(isinstance(event, StreamOpened) for event in fill(called, YOUNG))
    refused = StreamTarget(NODE, f"/n{YOUNG}")
    assert fill(called, 1, first=YOUNG) == [OpeningRefused(YOUNG, refused, reset_unit(YOUNG))]
    assert YOUNG not in called
    called.connected(3)
    called.receive(reset_unit(3), 0)
    (event,) = fill(called, 1, first=YOUNG + 1)
    assert isinstance(event, StreamOpened)
    (event,) = fill(called, 1, now=YOUNG_SECONDS + 0.1, first=YOUNG + 2)
    assert isinstance(event, StreamOpened)


def test_a_stream_that_is_over_counts_until_its_target_is_looked_for_no_more() -> None:
    called = Mux(Role.CALLED)
    for number in range(YOUNG):
        (event,) = fill(called, 1, first=number)
        assert isinstance(event, StreamOpened)
        called.receive(reset_unit(number), 0)
    assert len(called) == 0
    (event,) = fill(called, 1, now=2 * YOUNG_SECONDS, first=YOUNG)
    assert isinstance(event, OpeningRefused)
    called.connected(7)
    (event,) = fill(called, 1, first=YOUNG + 1)
    assert isinstance(event, StreamOpened)


def test_a_stream_whose_target_answered_twice_is_not_new() -> None:
    """The second answer follows the message that authenticates the caller."""
    caller, called = opened()
    fill(called, YOUNG - 1, first=1)
    called.receive(data(caller, 0, b"1"), 0)
    data(called, 0, b"2")
    data(called, 0, b"more of it")
    (event,) = fill(called, 1, first=YOUNG)
    assert isinstance(event, OpeningRefused)
    called.receive(data(caller, 0, b"3"), 0)
    data(called, 0, b"4")
    (event,) = fill(called, 1, first=YOUNG + 1)
    assert isinstance(event, StreamOpened)


def test_the_caller_waits_longer_than_the_other_side_counts() -> None:
    caller, _ = pair()
    for number in range(YOUNG):
        caller.open(StreamTarget(NODE, f"/n{number}"), 0)
    assert caller.crowded(ROBOT, YOUNG_SECONDS + 0.1) == "32 streams are new"
    with pytest.raises(StreamRefused, match=f"{YOUNG} streams are new"):
        caller.open(ROBOT, YOUNG_SECONDS + 0.1)
    assert caller.crowded(ROBOT, YOUNG_SECONDS + 5.1) == ""


def test_streams_are_bounded_and_those_to_one_name() -> None:
    caller, _ = pair()
    now = 0.0
    for _ in range(FOR_ONE_NAME):
        caller.open(ROBOT, now)
        now += 1
    assert caller.crowded(ROBOT, now)
    with pytest.raises(StreamRefused, match=f"{FOR_ONE_NAME} streams to it"):
        caller.open(ROBOT, now)
    for number in range(STREAMS - FOR_ONE_NAME):
        caller.open(StreamTarget(SERVICE, f"/s{number}"), now)
        now += 1
    with pytest.raises(StreamRefused, match=f"{STREAMS} streams are open"):
        caller.open(StreamTarget(SERVICE, "/other"), now)
    caller.reset(0)
    assert caller.crowded(ROBOT, now + 100) == ""


def test_numbers_are_never_used_again() -> None:
    caller, called = opened()
    called.receive(caller.reset(0), 0)
    number, unit = caller.open(ROBOT, 0)
    assert number == 1
    assert called.receive(unit, 0) == [StreamOpened(1, ROBOT)]
    assert not caller.used_up
    last = Mux(Role.CALLER, first=LAST_STREAM)
    assert last.open(ROBOT, 0)[0] == LAST_STREAM
    assert last.used_up
    with pytest.raises(StreamRefused, match="used up"):
        last.open(ROBOT, 0)
