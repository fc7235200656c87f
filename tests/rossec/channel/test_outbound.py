"""What a connection sends, and when it must not."""

import pytest

from rossec.channel.negotiation import ConnectionState
from rossec.channel.records import ChannelLimits
from rossec.errors import ChannelClosed, ChannelError, LimitExceeded, ProtocolViolation
from tests.support.wire import NOW, SMALL, alice, bob, joined, receive, wire


def test_a_unit_beyond_the_limit_is_refused_before_anything_happens() -> None:
    w = joined(left=alice(limits=ChannelLimits(unit=10)))
    with pytest.raises(LimitExceeded, match="11 bytes"):
        w.left.core.send_unit(b"x" * 11)
    w.left.core.send_unit(b"x" * 10)
    assert w.pump().right.units == [b"x" * 10]


def test_the_unit_limit_is_raised_after_authorization() -> None:
    limits = ChannelLimits(unit=100, preauth_limit=10)
    w = joined(right=bob(limits=limits))
    w.left.core.send_unit(b"x" * 10)
    w.pump().right.core.raise_unit_limit()
    w.left.core.send_unit(b"y" * 100)
    assert w.pump().right.units == [b"x" * 10, b"y" * 100]
    w.left.core.send_unit(b"z" * 101)
    assert isinstance(w.pump().right.error, LimitExceeded)
    w = joined(right=bob(limits=limits))
    w.left.core.send_unit(b"x" * 11)
    assert isinstance(w.pump().right.error, LimitExceeded)
    with pytest.raises(ChannelError):
        wire().right.core.raise_unit_limit()


def test_the_unit_limit_may_be_raised_to_a_given_size() -> None:
    w = joined(right=bob(limits=ChannelLimits(unit=100)))
    w.right.core.raise_unit_limit(20)
    w.left.core.send_unit(b"x" * 20)
    assert w.pump().right.units == [b"x" * 20]
    w.left.core.send_unit(b"x" * 21)
    assert isinstance(w.pump().right.error, LimitExceeded)
    w = joined(right=bob(limits=ChannelLimits(unit=100)))
    w.right.core.raise_unit_limit(1000)
    w.left.core.send_unit(b"x" * 101)
    assert isinstance(w.pump().right.error, LimitExceeded), "never more than the channel takes"


def test_sending_before_the_handshake_and_after_the_close() -> None:
    w = wire()
    with pytest.raises(ChannelClosed):
        w.right.core.send_unit(b"too early")
    w.pump()
    w.left.core.close()
    with pytest.raises(ChannelClosed):
        w.left.core.send_unit(b"too late")
    w.left.core.close()
    assert w.left.core.state is ConnectionState.CLOSING


def test_closing_during_the_handshake_sends_nothing() -> None:
    core = bob()
    core.close()
    assert core.state is ConnectionState.CLOSED
    assert core.data_to_send() == b""
    assert receive(core, b"whatever", NOW) == []


def test_records_sealed_meanwhile_go_first() -> None:
    w = joined(left=alice(limits=SMALL), right=bob(limits=SMALL))
    for _ in range(4):
        w.right.core.send_unit(b"to alice")
    records = w.left.core.seal_unit(b"x" * 300_000)
    sent = [next(records)]
    w.right.core.send_unit(b"after the rekey")
    w.left.give(w.right.take())  # alice follows the rekey, in the middle of her unit
    sent += records
    w.right.give(b"".join(sent))
    assert w.pump().right.units == [b"x" * 300_000]
    assert w.left.units[-1] == b"after the rekey"


def test_the_fast_path_of_small_units() -> None:
    w = joined(left=alice(limits=SMALL), right=bob(limits=SMALL))
    for count in range(4):
        record = w.left.core.seal_small(b"%d" % count)
        assert record is not None
        w.right.give(bytes(record))
    assert w.left.core.seal_small(b"a renewal is due") is None
    assert w.left.core.seal_small(b"") is None
    assert w.left.core.seal_small(b"x" * 100_000) is None
    w.left.core.send_unit(b"4")
    assert w.left.core.seal_small(b"something is queued") is None
    w.pump()
    assert w.right.units == [b"0", b"1", b"2", b"3", b"4"]
    w.left.core.close()
    assert w.left.core.seal_small(b"closed") is None


def test_bytes_put_back_are_sent_first() -> None:
    w = joined()
    record = w.left.core.seal_small(b"first")
    assert record is not None
    w.right.give(bytes(record[:10]))
    w.left.core.put_back(record[10:])
    w.left.core.put_back(b"")
    w.left.core.send_unit(b"second")
    w.pump()
    assert w.right.units == [b"first", b"second"]


def test_units_never_interleave() -> None:
    w = joined()
    records = w.left.core.seal_unit(b"x" * 600_000)
    w.right.give(bytes(next(records)))
    assert w.left.core.seal_small(b"y") is None
    with pytest.raises(ProtocolViolation, match="second unit"):
        w.left.core.send_unit(b"y")
    w.right.give(b"".join(records))
    w.left.core.send_unit(b"y")
    assert w.pump().right.units == [b"x" * 600_000, b"y"]


def test_an_abandoned_connection_sends_and_seals_nothing() -> None:
    """A forked process: its parent goes on with these keys and counters."""
    left = joined().left.core
    left.abandon()
    left.close()
    assert not left.has_data_to_send
    assert left.seal_small(b"x") is None
    with pytest.raises(ChannelClosed):
        left.send_unit(b"x")
