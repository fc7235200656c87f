"""The ends of a link: in order, by a reset, by what no peer sends."""

import pytest

from rossec.errors import LinkEnded
from rossec.overlay import link_frames
from rossec.overlay.link import Link, LinkState
from rossec.overlay.link_frames import LinkFrameKind
from rossec.overlay.link_sides import LINGER, PROGRESS_TIMEOUT
from tests.support.linknet import ID, REPLY, frame, opened


def test_both_sides_end() -> None:
    network = opened()
    network.write(network.caller, bytes(500_000))
    network.caller.at().finish(network.now)
    assert network.caller.at().state is LinkState.DRAINING
    network.flush(network.caller)
    network.run(lambda: network.called.at().peer_ended)
    assert len(network.called.received) == 500_005
    network.write(network.called, b"the answer")
    network.called.at().finish(network.now)
    network.flush(network.called)
    network.run(lambda: all(end.at().state is LinkState.DONE for end in network.ends), within=1)
    assert network.agreed()
    assert network.caller.at().peer_ended
    network.caller.at().write(b"too late", network.now)
    assert network.caller.at().frames_to_send(network.now) == []
    assert network.caller.at().receive(frame(LinkFrameKind.DATA, body=b"late"), network.now) == []


def test_a_side_that_ended_does_not_wait_for_ever_for_the_other() -> None:
    network = opened()
    network.caller.at().finish(network.now)
    network.flush(network.caller)
    network.run(lambda: network.caller.at().state is LinkState.DONE, within=LINGER + 1)
    network.called.at().finish(network.now)
    network.flush(network.called)
    network.run(lambda: network.called.at().state is LinkState.DONE, within=LINGER + 1)


def test_a_side_that_writes_to_one_that_is_done_is_over_in_time() -> None:
    network = opened()
    network.caller.at().finish(network.now)
    network.flush(network.caller)
    network.run(lambda: network.caller.at().state is LinkState.DONE, within=LINGER + 1)
    network.write(network.called, b"nobody reads this")
    with pytest.raises(LinkEnded):
        network.pass_time(PROGRESS_TIMEOUT + 1)


def test_a_lost_last_acknowledgement_ends_in_order() -> None:
    network = opened()
    for end in network.ends:
        end.at().finish(network.now)
        network.flush(end)
    network.run(lambda: any(end.at().peer_ended for end in network.ends))
    network.cut = True
    network.pass_time(LINGER + PROGRESS_TIMEOUT)
    assert {end.at().state for end in network.ends} == {LinkState.DONE}


def test_an_open_that_nobody_answered_ends_at_once() -> None:
    link = Link.open(ID, REPLY, 0.0)
    link.write(b"hello", 0.0)
    link.frames_to_send(0.0)
    link.finish(0.1)
    assert link.state is LinkState.RESET
    assert [sent[0] for sent in link.frames_to_send(0.1)] == [LinkFrameKind.RESET]


def test_a_reset_ends_both_sides_and_is_not_answered() -> None:
    network = opened()
    last = network.caller.at().reset()
    assert network.caller.at().state is LinkState.RESET
    with pytest.raises(LinkEnded, match="reset the link"):
        network.called.at().receive(last, network.now)
    assert network.called.at().frames_to_send(network.now) == []
    for end in network.ends:
        end.at().consumed(0, network.now)
        end.at().validated()
        end.at().finish(network.now)
        assert end.at().state is LinkState.RESET


@pytest.mark.parametrize(
    ("forged", "reason"),
    [
        (b"", "forbidden length"),
        (frame(LinkFrameKind.DATA, body=b"x", link=bytes(16)), "another link"),
        (frame(LinkFrameKind.DATA, offset=1 << 40, body=b"x"), "more than it was allowed"),
        (frame(LinkFrameKind.ACK, received=1 << 40), "not sent"),
        (frame(LinkFrameKind.END, offset=2), "before its end"),
        (frame(LinkFrameKind.OPEN, body=link_frames.return_address(REPLY[:-1] + "b", 600)), "another OPEN"),
    ],
    ids=["empty", "link", "limit", "acknowledgement", "end", "open"],
)
def test_what_no_peer_sends_ends_the_link_and_says_so(forged: bytes, reason: str) -> None:
    called = opened().called.at()
    with pytest.raises(LinkEnded, match=reason):
        called.receive(forged, 1.0)
    assert called.state is LinkState.RESET
    assert [sent[0] for sent in called.frames_to_send(1.0)] == [LinkFrameKind.RESET]


def test_an_answer_to_a_link_that_was_not_opened_is_refused() -> None:
    link = Link.open(ID, REPLY, 0.0)
    with pytest.raises(LinkEnded, match="not opened"):
        link.receive(frame(LinkFrameKind.ACK), 0.0)


@pytest.mark.parametrize(
    "first",
    [
        frame(LinkFrameKind.DATA, body=b"x"),
        frame(LinkFrameKind.OPEN, offset=1, body=link_frames.return_address(REPLY, 600)),
        frame(LinkFrameKind.OPEN, body=link_frames.return_address("rossec/1/open/*", 600)),
    ],
    ids=["data", "offset", "wildcard"],
)
def test_a_link_begins_with_an_open_in_form(first: bytes) -> None:
    with pytest.raises(LinkEnded):
        Link.accept(first, 0.0)
