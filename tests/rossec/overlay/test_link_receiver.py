"""The receiving half of a link: order, gaps, limits, and when it acknowledges."""

import pytest

from rossec.errors import LinkEnded
from rossec.overlay.link_sides import ACK_DELAY, FIRST_WINDOW, MOST_WINDOW, Receiver

STREAM = bytes(range(256)) * 16


def receiver() -> Receiver:
    """One whose peer is authenticated and knows so."""
    made = Receiver()
    made.widen(0.0)
    made.told(ack=True)
    return made


def give(to: Receiver, first: int, end: int, now: float = 1.0) -> bytes:
    return b"".join(to.data(first, memoryview(STREAM[first:end]), now))


def test_bytes_in_order_are_passed_on_as_they_are() -> None:
    to = receiver()
    body = memoryview(STREAM[:10])
    (piece,) = to.data(0, body, 1.0)
    assert piece is body
    assert (to.expected, to.seen) == (10, 10)


def test_what_comes_beyond_a_gap_is_kept_until_it_is_closed() -> None:
    to = receiver()
    assert give(to, 20, 30) == b""
    assert give(to, 10, 20) == b""
    assert give(to, 50, 60) == b""
    assert to.ranges() == [(10, 30), (50, 60)]
    assert give(to, 0, 10) == STREAM[:30]
    assert to.ranges() == [(50, 60)]
    assert give(to, 30, 55) == STREAM[30:60]
    assert to.ranges() == []


def test_repeated_and_overlapping_bytes_are_passed_on_once() -> None:
    to = receiver()
    assert give(to, 0, 20) == STREAM[:20]
    assert give(to, 0, 20) == b""
    assert give(to, 10, 30) == STREAM[20:30]
    assert give(to, 40, 50) == b""
    for first, end in ((40, 50), (35, 45), (45, 55), (41, 42)):
        assert give(to, first, end) == b""
    assert to.ranges() == [(40, 50)], "overlaps would be kept twice"
    assert give(to, 30, 41) == STREAM[30:50]


def test_before_authentication_nothing_is_kept_beyond_a_gap() -> None:
    to = Receiver()
    assert give(to, 10, 20) == b""
    assert to.ranges() == []
    assert to.ack_at == 1.0


def test_frames_beyond_a_gap_are_counted() -> None:
    to = receiver()
    for at in range(1, 2000):
        to.data(2 * at, memoryview(b"x"), 1.0)
    assert len(to.ranges()) == 512


def test_more_than_the_limit_ends_the_link() -> None:
    to = Receiver()
    with pytest.raises(LinkEnded, match="more than it was allowed"):
        to.data(FIRST_WINDOW - 1, memoryview(b"xx"), 1.0)


def test_the_limit_counts_when_it_was_told() -> None:
    to = Receiver()
    to.widen(0.0)
    with pytest.raises(LinkEnded):
        to.data(FIRST_WINDOW, memoryview(b"x"), 1.0)
    to.told(ack=True)
    assert to.data(FIRST_WINDOW, memoryview(b"x"), 1.0) == []


def test_the_limit_moves_with_what_was_consumed() -> None:
    to = receiver()
    give(to, 0, 100)
    to.told()
    to.consumed(100, 2.0)
    assert to.limit == MOST_WINDOW + 100
    assert to.ack_at is None, "so little is told with the next frame"
    with pytest.raises(ValueError, match="more was consumed"):
        to.consumed(1, 2.0)


def test_a_window_that_opens_is_told_at_once() -> None:
    to = receiver()
    size = MOST_WINDOW // 4
    to.data(0, memoryview(bytes(size)), 1.0)
    to.told(ack=True)
    to.consumed(size, 2.0)
    assert to.ack_at == 2.0


def test_a_small_frame_is_acknowledged_after_a_while_and_many_at_once() -> None:
    to = receiver()
    give(to, 0, 10)
    assert to.ack_at == 1.0 + ACK_DELAY
    for at in range(1, 16):
        give(to, 10 * at, 10 * at + 10, 1.001)
    assert to.ack_at == 1.001
    to.told()
    assert to.ack_at is None


def test_a_large_frame_is_acknowledged_at_once() -> None:
    to = receiver()
    to.data(0, memoryview(bytes(40_000)), 1.0)
    assert to.ack_at == 1.0


@pytest.mark.parametrize("event", ["gap", "repeat", "probe"])
def test_what_only_an_acknowledgement_answers_is_due_until_one_leaves(event: str) -> None:
    to = receiver()
    give(to, 0, 10)
    to.told()
    if event == "probe":
        to.probed(70, 2.0)
    else:
        give(to, *((20, 30) if event == "gap" else (0, 10)), 2.0)
    to.told()
    assert to.ack_at == 2.0
    to.told(ack=True)
    assert to.ack_at is None


def test_a_probe_says_how_far_the_peer_sent() -> None:
    to = receiver()
    to.probed(70, 1.0)
    assert to.seen == 70
    to.probed(1 << 60, 1.0)
    assert to.seen == MOST_WINDOW + 1, "nobody sent beyond the limit"


def test_the_end_counts_when_all_before_it_arrived() -> None:
    to = receiver()
    to.end(10, 1.0)
    assert (to.ended, to.seen) == (False, 11)
    give(to, 0, 10)
    to.end(10, 1.0)
    assert to.ended
    assert to.expected == 11
    to.end(10, 1.0)
    assert give(to, 0, 10) == b""


@pytest.mark.parametrize("offset", [9, 29], ids=["received", "kept"])
def test_an_end_before_what_was_received_is_refused(offset: int) -> None:
    to = receiver()
    give(to, 0, 10)
    give(to, 20, 30)
    with pytest.raises(LinkEnded, match="before its end"):
        to.end(offset, 1.0)


def test_nothing_follows_the_end() -> None:
    to = receiver()
    to.end(0, 1.0)
    with pytest.raises(LinkEnded, match="after its end"):
        give(to, 1, 2)
    with pytest.raises(LinkEnded, match="twice"):
        to.end(5, 1.0)


def test_a_link_that_is_over_keeps_nothing() -> None:
    to = receiver()
    give(to, 20, 30)
    to.forget()
    assert to.ranges() == []
    assert to.ack_at is None
