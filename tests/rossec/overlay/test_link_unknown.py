"""A peer that is not authenticated is sent little; a link that is not known, a refusal at most."""

from itertools import count

import pytest

from rossec.errors import LinkEnded
from rossec.overlay import link_frames
from rossec.overlay.link import AMPLIFICATION, Link
from rossec.overlay.link_frames import HEAD, OPEN_SIZE, LinkFrameKind, refusal
from rossec.overlay.link_sides import KEEPALIVE, PROGRESS_TIMEOUT
from tests.support.linknet import REPLY, LinkNetwork, frame, opened


def test_an_open_with_a_forged_reply_key_is_not_amplified() -> None:
    """The called side answers as much as it likes; the inbox it is sent to is silent."""
    first = frame(LinkFrameKind.OPEN, body=link_frames.return_address(REPLY, OPEN_SIZE - HEAD))
    link = Link.accept(first, 0.0)
    link.receive(first, 0.0)
    link.write(bytes(100_000), 0.0)
    link.finish(0.0)
    octets = 0
    for tenths in range(10 * int(PROGRESS_TIMEOUT)):
        octets += sum(map(len, link.frames_to_send(tenths / 10)))
        link.tick(tenths / 10)
    with pytest.raises(LinkEnded):
        link.tick(PROGRESS_TIMEOUT)
    octets += sum(map(len, link.frames_to_send(PROGRESS_TIMEOUT)))
    assert octets <= AMPLIFICATION * len(first)
    assert octets > 2 * len(first), "it did answer"


@pytest.mark.parametrize("every", [3, 5, 1000])
def test_a_long_answer_before_authentication_arrives_within_the_bound(every: int) -> None:
    """As EDHOC's message_2 with long certificates: the caller's probes pay for what is missing."""
    number = count(1)
    network = LinkNetwork(lambda _: () if next(number) % every == 0 else (0.01,))
    network.called.validates_at = network.caller.validates_at = 10_000
    network.write(network.caller, bytes(400))
    network.run(lambda: network.called.link is not None)
    network.write(network.called, bytes(8000))
    while not network.agreed():
        network.step()
        assert network.called.octets_out <= AMPLIFICATION * network.called.octets_in
    assert network.now < 10


def test_a_peer_that_is_never_authenticated_is_given_up() -> None:
    network = LinkNetwork()
    for end in (network.caller, network.called):
        end.validates_at = 1 << 30
    network.write(network.caller, b"hello")
    with pytest.raises(LinkEnded, match="no progress"):
        network.pass_time(PROGRESS_TIMEOUT + 1)
    assert network.now == pytest.approx(PROGRESS_TIMEOUT, abs=0.5)


# -- a relay that was started again


def test_a_probe_of_an_unknown_link_is_refused_where_it_says() -> None:
    network = opened()
    network.cut = True
    network.caller.kinds.clear()
    link = network.caller.at()
    moment = network.now + KEEPALIVE
    link.tick(moment)
    (probe,) = link.frames_to_send(moment)
    refused = refusal(probe)
    assert refused is not None
    key, reset = refused
    assert key == REPLY
    assert len(reset) <= len(probe)
    with pytest.raises(LinkEnded, match="reset"):
        link.receive(reset, moment)


@pytest.mark.parametrize(
    "unknown",
    [
        frame(LinkFrameKind.DATA, body=b"x"),
        frame(LinkFrameKind.ACK),
        frame(LinkFrameKind.RESET),
        frame(LinkFrameKind.PROBE),
        frame(LinkFrameKind.PROBE, body=link_frames.return_address("rossec/**", 0)),
    ],
    ids=["data", "ack", "reset", "probe", "wildcard"],
)
def test_nothing_else_of_an_unknown_link_is_answered(unknown: bytes) -> None:
    assert refusal(unknown) is None
