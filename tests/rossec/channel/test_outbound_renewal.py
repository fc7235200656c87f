"""Deadlines, key renewal and the limits of keys."""

import pytest

from rossec.channel.negotiation import ConnectionState
from rossec.channel.records import ChannelLimits
from rossec.errors import HandshakeTimeout, LimitExceeded
from tests.support.wire import NOT_AFTER, NOW, SMALL, alice, bob, joined


def test_the_handshake_has_one_deadline() -> None:
    core = bob()
    assert core.deadline() == NOW + 5
    core.tick(NOW + 4)
    with pytest.raises(HandshakeTimeout):
        core.tick(NOW + 5)
    core.tick(NOW + 6)


def test_the_connection_ends_with_the_peers_certificate() -> None:
    w = joined(right=bob(limits=ChannelLimits(seconds=1 << 40)))
    assert w.right.core.deadline() == NOT_AFTER
    with pytest.raises(LimitExceeded, match="certificate has expired"):
        w.right.core.tick(NOT_AFTER)
    assert w.right.core.state is ConnectionState.CLOSED


def test_keys_are_renewed_by_time() -> None:
    w = joined(left=alice(limits=SMALL), right=bob(limits=SMALL))
    assert w.left.core.deadline() == NOW + 100
    w.left.core.tick(NOW + 100)
    assert w.left.take() == b""  # not used: nothing to renew
    w.left.core.send_unit(b"a")
    w.left.core.tick(NOW + 200)
    w.pump()
    w.left.core.send_unit(b"b")
    w.right.core.send_unit(b"c")
    assert w.pump().right.units == [b"a", b"b"]
    assert w.left.units == [b"c"]


def test_a_peer_that_does_not_follow_a_renewal_ends_the_connection() -> None:
    w = joined(left=alice(limits=SMALL), right=bob(limits=SMALL))
    w.left.core.send_unit(b"a")
    w.left.core.tick(NOW + 100)
    with pytest.raises(LimitExceeded):
        w.left.core.tick(NOW + 200)
    assert w.left.core.state is ConnectionState.CLOSED


def test_renewal_both_ways_and_one_way() -> None:
    w = joined(left=alice(limits=SMALL), right=bob(limits=SMALL))
    for count in range(50):
        w.left.core.send_unit(b"left %d" % count)
        if count % 3 == 0:
            w.right.core.send_unit(b"right %d" % count)
        w.pump()
    assert len(w.right.units) == 50
    assert len(w.left.units) == 17
    assert w.left.error is None
    assert w.right.error is None


def test_the_hard_stop_of_the_sender() -> None:
    w = joined(left=alice(limits=SMALL), right=bob(limits=SMALL))
    for _ in range(4 + 8):
        w.left.core.send_unit(b"x")
    with pytest.raises(LimitExceeded, match="does not follow"):
        w.left.core.send_unit(b"x")
    assert w.left.take() == b""
    assert w.left.core.state is ConnectionState.CLOSED


def test_the_hard_stop_of_the_receiver() -> None:
    w = joined(right=bob(limits=SMALL))
    for _ in range(9):
        w.left.core.send_unit(b"x")
        w.pump()
    assert isinstance(w.right.error, LimitExceeded)
    assert len(w.right.units) == 8
