"""A message that was begun, in however many units, must get on."""

import pytest

from rossec.errors import LimitExceeded, WireError
from rossec.peer_limits import STEP, WINDOW
from rossec.ros.tcpros import FrameReader, Framing, frame

NOW = 1_000_000


def incomplete(framing: Framing) -> bool:
    return framing.incomplete


def test_messages_are_cut_as_the_reader_cuts_them() -> None:
    framing = Framing(FrameReader())
    assert incomplete(framing) is False
    assert framing.feed(frame(b"one") + frame(b"two")[:5], NOW) == [b"one"]
    assert incomplete(framing) is True
    assert framing.feed(frame(b"two")[5:], NOW) == [b"two"]
    assert incomplete(framing) is False
    with pytest.raises(WireError):
        Framing(FrameReader(10)).feed(frame(bytes(11)), NOW)


def test_messages_that_follow_each_other_may_go_on_for_ever() -> None:
    """Each unit ends one and begins another; so does a service that is called again and again."""
    framing, data = Framing(FrameReader()), frame(b"x" * 10) * 1000
    for second, start in enumerate(range(0, len(data), 14)):
        framing.feed(data[start : start + 14], NOW + second)
        framing.check_progress(NOW + second)
    calls, half = Framing(FrameReader()), frame(b"x" * 10)
    for second in range(0, 20 * WINDOW, STEP):
        assert calls.feed_one(half[:5], NOW + second) is None
        assert calls.feed_one(half[5:], NOW + second) == b"x" * 10


@pytest.mark.parametrize("feed", ["feed", "feed_one"])
def test_a_stalled_message_is_refused(feed: str) -> None:
    framing = Framing(FrameReader())
    getattr(framing, feed)(frame(bytes(100))[:50], NOW)
    with pytest.raises(LimitExceeded):  # noqa: PT012 - at last
        for second in range(0, 2 * WINDOW, STEP):
            framing.check_progress(NOW + second)
    framing = Framing(FrameReader())
    with pytest.raises(LimitExceeded):  # noqa: PT012 - at last
        for second in range(2 * WINDOW):  # drop by drop
            getattr(framing, feed)(frame(bytes(1000))[second : second + 1], NOW + second)
