"""A link between two inboxes: what arrives, what is sent again, and when a link is over."""

import pytest

from rossec.errors import LinkEnded
from rossec.overlay.link import Link, LinkState
from rossec.overlay.link_frames import HEAD, OPEN_SIZE, LinkFrameKind
from rossec.overlay.link_sides import KEEPALIVE, PROGRESS_TIMEOUT
from tests.support.linknet import ID, REPLY, LinkNetwork, opened


def test_bytes_arrive_in_both_directions() -> None:
    network = opened()
    network.write(network.caller, bytes(3_000_000))
    network.write(network.called, b"x" * 700_000)
    network.run(network.agreed)
    stats = network.caller.at().stats
    assert stats.retransmissions == 0
    assert stats.sent == 3_000_005
    assert stats.received == 700_007
    assert 0.019 < stats.srtt_s < 0.04


def test_a_link_that_is_not_written_to_sends_nothing() -> None:
    link = Link.open(ID, REPLY, 0.0)
    link.write(b"", 0.0)
    assert link.frames_to_send(0.0) == []
    assert link.deadline() is None
    link.tick(1000.0)
    assert link.state is LinkState.IDLE


def test_a_link_that_nobody_used_ends_at_once() -> None:
    link = Link.open(ID, REPLY, 0.0)
    link.finish(0.0)
    assert link.state is LinkState.DONE


def test_an_identifier_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="16 bytes"):
        Link.open(b"short", REPLY, 0.0)


def test_the_first_frame_is_a_padded_open_that_is_repeated_until_it_is_answered() -> None:
    link = Link.open(ID, REPLY, 0.0)
    link.write(b"first", 0.0)
    link.write(b" second", 0.0)
    (first,) = link.frames_to_send(0.0)
    assert len(first) == OPEN_SIZE
    assert first[-5:] == b"first", "what follows waits for an answer"
    moment = link.deadline()
    assert moment == 0.2
    link.tick(0.2)
    assert link.frames_to_send(0.2) == [first]
    called = Link.accept(first, 1.0)
    assert called.reply_key == REPLY
    assert [bytes(piece) for piece in called.receive(first, 1.0)] == [b"first"]
    assert called.receive(first, 1.1) == []
    (answer,) = called.frames_to_send(1.1)
    link.receive(answer, 1.2)
    assert link.state is LinkState.RUNNING
    (second,) = link.frames_to_send(1.2)
    assert second[HEAD:] == b" second"


def test_a_large_first_write_is_cut_to_what_an_unknown_peer_takes() -> None:
    network = LinkNetwork()
    network.write(network.caller, bytes(300_000))
    network.run(network.agreed)


def test_small_messages_are_acknowledged_by_the_answer() -> None:
    network = opened()
    for end in network.ends:
        end.kinds.clear()
    for _ in range(20):
        for end in network.ends:
            network.write(end, b"ping")
            network.run(network.agreed)
    kinds = [kind for end in network.ends for kind in end.kinds]
    assert kinds.count(LinkFrameKind.DATA) == 40
    assert kinds.count(LinkFrameKind.ACK) == 0


def test_what_is_not_answered_is_acknowledged_soon() -> None:
    network = opened()
    network.write(network.caller, b"alone")
    network.pass_time(0.05)
    assert network.called.kinds[-1] is LinkFrameKind.ACK


def test_a_loss_is_noticed_by_what_follows_and_only_it_is_sent_again() -> None:
    network = opened()
    network.cut = True
    network.write(network.caller, bytes(1000))
    network.cut = False
    for _ in range(10):
        network.write(network.caller, bytes(1000))
    assert network.run(network.agreed) < 0.05
    assert network.caller.at().stats.retransmissions == 1


def test_a_lost_tail_is_asked_for() -> None:
    network = opened()
    network.cut = True
    for _ in range(3):
        network.write(network.caller, bytes(1000))
    network.cut = False
    assert network.run(network.agreed) < 0.3
    assert network.caller.at().stats.retransmissions == 3
    assert LinkFrameKind.PROBE in network.caller.kinds


@pytest.mark.parametrize("seconds", [0.3, 1.0, 3.0, 10.0, 25.0])
def test_after_an_interruption_a_link_goes_on_soon(seconds: float) -> None:
    network = opened()
    network.cut = True
    network.write(network.caller, bytes(200_000))
    network.pass_time(seconds)
    network.cut = False
    assert network.run(network.agreed) < 0.3 + seconds / 8


def test_a_link_without_progress_is_over() -> None:
    network = opened()
    network.cut = True
    network.write(network.caller, b"never arrives")
    begin = network.now
    with pytest.raises(LinkEnded, match="no progress") as refused:
        network.pass_time(PROGRESS_TIMEOUT + 10)
    assert refused.value.hint
    assert network.now - begin == pytest.approx(PROGRESS_TIMEOUT, abs=0.5)
    assert network.caller.at().state is LinkState.RESET
    assert network.caller.at().deadline() is None
    network.caller.at().tick(network.now)
    (last,) = network.caller.at().frames_to_send(network.now)
    assert last[0] == LinkFrameKind.RESET


def test_an_idle_link_lives_and_asks_now_and_then() -> None:
    network = opened()
    for end in network.ends:
        end.kinds.clear()
    network.pass_time(600)
    kinds = [kind for end in network.ends for kind in end.kinds]
    assert set(kinds) == {LinkFrameKind.PROBE, LinkFrameKind.ACK}
    assert len(kinds) <= 4 * 600 / KEEPALIVE
    network.write(network.called, b"still there")
    network.run(network.agreed)


def test_an_idle_link_whose_peer_is_gone_is_over() -> None:
    network = opened()
    network.cut = True
    with pytest.raises(LinkEnded):
        network.pass_time(PROGRESS_TIMEOUT + 3 * KEEPALIVE)


def test_a_slow_application_closes_the_window_and_opens_it_again() -> None:
    network = opened()
    network.called.slow = True
    caller = network.caller.at()
    network.write(network.caller, bytes(6_000_000))
    network.pass_time(100)
    assert len(network.called.received) <= 4 * 1024 * 1024 + 5
    assert caller.state is LinkState.RUNNING, "it is slow, not gone"
    assert (caller.writable, caller.backlog > 1_000_000) == (False, True)
    network.called.slow = False
    network.take(network.called)
    network.flush(network.called)
    network.run(network.agreed)
    assert (caller.writable, caller.backlog) == (True, 0)


def test_a_window_that_opens_unnoticed_is_asked_for() -> None:
    network = opened()
    network.called.slow = True
    network.write(network.caller, bytes(6_000_000))
    network.pass_time(5)
    network.cut = True
    network.called.slow = False
    network.take(network.called)
    network.flush(network.called)
    network.cut = False
    network.run(network.agreed, within=5)


@pytest.mark.parametrize("rate", [100_000, 400_000])
def test_on_a_slow_line_nothing_waits_behind_long_queues(rate: int) -> None:
    """Bytes a second; its buffers take everything."""
    network = opened()
    network.rate = rate
    caller = network.caller.at()
    while network.now < 6:
        while caller.backlog == 0:
            network.write(network.caller, bytes(20_000))
        network.step()
    assert len(network.called.received) > 0.8 * 6 * rate
    assert caller.stats.srtt_s < 0.3
    assert caller.stats.retransmissions == 0
