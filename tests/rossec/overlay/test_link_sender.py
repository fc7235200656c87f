"""The sending half of a link: what may be sent, what was lost, what is sent again."""

import pytest

from rossec.channel.records import Bytes
from rossec.errors import LinkEnded
from rossec.overlay.link_frames import MAX_BODY, MAX_RANGES
from rossec.overlay.link_sides import FIRST_WINDOW, MOST_FRAMES, Sender

MANY = 1 << 30


def sender(*sizes: int, at: float = 0.0) -> Sender:
    """One with frames of such sizes on the way; each frame is its number."""
    made = Sender()
    for number, size in enumerate(sizes):
        made.sent(str(number).encode(), size, at)
    return made


def resent(of: Sender, now: float = 1.0, most: int = MANY) -> list[bytes]:
    found = []
    while (frame := of.resend(most, now)) is not None:
        found.append(frame)
    return found


def sizes(pieces: list[Bytes]) -> list[int]:
    return [len(piece) for piece in pieces]


def test_room_is_what_limit_and_window_leave() -> None:
    assert sender().room() == FIRST_WINDOW
    assert sender(1000).room() == FIRST_WINDOW - 1000
    of = sender(1000)
    of.received(1000, FIRST_WINDOW, 1.0)
    assert of.room() == FIRST_WINDOW - 1000, "the peer's limit did not move"
    of.received(1000, 1 << 40, 1.0)
    assert of.room() == FIRST_WINDOW, "the congestion window did not grow: it was not used"


def test_frames_on_the_way_are_counted() -> None:
    of = sender(*MOST_FRAMES * [1])
    assert of.room() == 0
    of.received(1, 1 << 40, 1.0)
    assert of.room() > 0


def test_what_fits_is_sent_at_once_and_before_nothing_else() -> None:
    of = sender()
    assert of.fits(FIRST_WINDOW)
    assert not of.fits(FIRST_WINDOW + 1)
    assert not of.fits(MAX_BODY + 1)
    of.queue(b"first")
    assert not of.fits(1)


def test_what_waits_is_a_copy_and_leaves_joined() -> None:
    of = sender()
    scratch = bytearray(b"abc")
    of.queue(scratch)
    scratch[:] = b"xyz"
    of.queue(memoryview(b"def"))
    of.queue(b"")
    assert of.backlog == 6
    assert b"".join(of.cut(MANY)) == b"abcdef"
    assert of.backlog == 0
    assert of.cut(MANY) == []


def test_a_piece_is_cut_where_room_ends() -> None:
    of = sender()
    of.queue(bytes(FIRST_WINDOW + 10))
    assert sizes(of.cut(MANY)) == [FIRST_WINDOW]
    assert of.backlog == 10
    of.sent(b"", FIRST_WINDOW, 0.0)
    assert of.cut(MANY) == []


def test_a_body_has_the_length_of_a_record_at_most() -> None:
    of = sender()
    of.received(0, 1 << 40, 0.0)
    of.window.size = 1 << 30
    of.queue(bytes(2 * MAX_BODY))
    assert sizes(of.cut(MANY)) == [MAX_BODY]
    assert sizes(of.cut(100)) == [100]


def test_nothing_small_is_cut_while_answers_are_to_come() -> None:
    of = sender(FIRST_WINDOW - 1000)
    of.queue(bytes(5000))
    assert of.cut(MANY) == []
    of.received(FIRST_WINDOW - 1000, FIRST_WINDOW, 1.0)
    assert sizes(of.cut(MANY)) == [1000], "nothing else would ever make room"


def test_an_acknowledgement_frees_what_arrived() -> None:
    of = sender(10, 10, 10)
    assert of.received(20, 0, 0.5)
    assert of.base == 20
    assert of.in_flight
    assert not of.received(20, 0, 0.6)
    assert not of.received(5, 0, 0.6)
    assert of.round_trip.srtt_s == 0.5
    of.received(30, 0, 0.6)
    assert not of.waiting


def test_what_was_not_sent_cannot_be_acknowledged() -> None:
    with pytest.raises(LinkEnded, match="not sent"):
        sender(10).received(11, 0, 0.0)


def test_what_the_peer_passed_over_is_lost_and_sent_again_once() -> None:
    of = sender(10, 10, 10, 10)
    of.seen(30, [(10, 20)], 0.5)
    assert resent(of) == [b"0", b"2"], "1 arrived, and 3 may be on the way"
    assert of.retransmissions == 2
    of.seen(30, [(10, 20)], 1.005)
    assert resent(of, 1.005) == [], "it may be on the way"
    of.seen(30, [(10, 20)], 1.5)
    assert resent(of, 1.5) == [b"0", b"2"]


def test_what_arrives_meanwhile_is_not_sent_again() -> None:
    of = sender(10, 10, 10)
    of.seen(30, [], 0.5)
    of.received(10, 0, 0.6)
    of.seen(30, [(20, 30)], 0.6)
    assert resent(of) == [b"1"]


def test_what_many_ranges_do_not_say_is_not_lost() -> None:
    of = sender(*100 * [10])
    ranges = [(20 * at + 10, 20 * at + 20) for at in range(MAX_RANGES)]
    of.seen(1000, ranges, 0.5)
    assert len(resent(of)) == MAX_RANGES


def test_a_lost_frame_waits_for_leave_and_room() -> None:
    of = sender(10)
    of.seen(10, [], 0.5)
    assert resent(of, most=0) == []
    assert of.room() == 0, "what is lost goes first"
    assert resent(of, most=1) == [b"0"]
    assert of.room() > 0


def test_lost_frames_do_not_fill_more_than_the_window() -> None:
    size = FIRST_WINDOW // 8
    of = sender(*8 * [size])
    of.seen(FIRST_WINDOW, [], 0.5)
    assert of.window.size == 4 * size
    assert resent(of) == [b"0", b"1", b"2", b"3"]
    of.received(size, 0, 2.0)
    assert of.window.size == 5 * size
    assert resent(of) == [b"4", b"5"]


@pytest.mark.parametrize("event", ["repeated", "lost"])
def test_what_has_two_answers_measures_no_round_trip(event: str) -> None:
    of = sender(10)
    if event == "repeated":
        assert of.repeat_first(0.3) == b"0"
    else:
        of.seen(10, [], 0.2)
        resent(of, 0.3)
    of.received(10, 0, 5.0)
    assert of.round_trip.srtt_s == 0.0


def test_a_least_window_takes_the_round_trip_as_it_is() -> None:
    of = sender()
    of.round_trip.sample(0.1)
    for number in range(100):
        of.sent(b"", FIRST_WINDOW, float(number))
        of.received(of.next, 0, number + 0.9)
    assert of.round_trip.queued_s < 0.1
    assert of.window.size > FIRST_WINDOW, "it is a longer way, not a queue"


def test_a_link_that_is_over_keeps_nothing() -> None:
    of = sender(10)
    of.queue(b"more")
    of.forget()
    assert not of.waiting
    assert of.backlog == 0
