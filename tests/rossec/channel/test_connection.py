"""One connection from end to end: units, buffers, closes."""

import pytest

from rossec.channel.opening import WireProtocol
from rossec.channel.records import Bytes, ChannelLimits
from rossec.channel.states import Closed, ConnectionState
from rossec.errors import (
    ChannelClosed,
    ChannelError,
    ConnectionTruncated,
    HandshakeFailed,
    LimitExceeded,
    ProtocolViolation,
    RecordForged,
)
from rossec.progress import STEP, WINDOW
from tests.support.wire import (
    NOW,
    SMALL,
    End,
    Wire,
    alice,
    bob,
    joined,
    peers,
    wire,
)


@pytest.mark.parametrize("step", [0, 1, 7])
@pytest.mark.parametrize("protocol", list(WireProtocol))
def test_a_connection_from_end_to_end(protocol: WireProtocol, step: int) -> None:
    w = wire(alice(protocol), step=step).pump()
    assert peers(w.left) == ["/bob"]
    assert peers(w.right) == ["/alice"]
    w.left.core.send_unit(b"hello ", bytearray(b"bob"))
    w.right.core.send_unit(b"hello ", memoryview(b"alice"))
    w.pump()
    assert w.right.units == [b"hello bob"]
    assert w.left.units == [b"hello alice"]
    w.left.core.close()
    w.pump()
    assert w.right.events[-1] == Closed()
    w.left.core.receive_eof()
    w.right.core.receive_eof()
    assert w.left.core.state is ConnectionState.CLOSED
    assert w.right.core.state is ConnectionState.CLOSED
    assert w.right.core.protocol is protocol
    assert w.left.error is None
    assert w.right.error is None


def test_the_first_record_may_travel_with_message_3() -> None:
    w = wire()
    w.right.give(w.left.take())
    w.left.give(w.right.take())
    w.left.core.send_unit(b"early")
    w.right.give(w.left.take())
    assert w.right.units == [b"early"]


def test_large_units_of_many_pieces() -> None:
    w = joined()
    pieces: list[Bytes] = [
        b"a",
        b"b" * 300_000,
        bytearray(b"c" * 20_000),
        b"",
        b"d",
        memoryview(b"e" * 700_000),
    ]
    w.right.core.send_unit(*pieces)
    w.right.core.send_unit(b"f" * 600_000)
    w.pump()
    assert w.left.units == [b"".join(pieces), b"f" * 600_000]


def test_an_empty_unit_sends_nothing() -> None:
    w = joined()
    w.left.core.send_unit()
    w.left.core.send_unit(b"")
    assert w.left.take() == b""


def test_a_unit_beyond_the_limit_is_refused_before_anything_happens() -> None:
    w = joined(left=alice(limits=ChannelLimits(unit=10)))
    with pytest.raises(LimitExceeded, match="11 bytes"):
        w.left.core.send_unit(b"x" * 11)
    w.left.core.send_unit(b"x" * 10)
    assert w.pump().right.units == [b"x" * 10]


@pytest.mark.parametrize("size", [11, 300_000])
def test_a_peer_that_sends_a_unit_beyond_the_limit(size: int) -> None:
    w = joined(right=bob(limits=ChannelLimits(unit=10)))
    w.left.core.send_unit(b"x" * size)
    assert isinstance(w.pump().right.error, LimitExceeded)
    assert w.right.units == []


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


def begins(end: End) -> bool:
    return end.core.has_unfinished_unit


def test_an_incomplete_unit_must_make_progress() -> None:
    """Whether bytes come or not; only while this side reads; small units are begun and ended."""
    w = joined(right=bob())
    core, begun = w.right.core, w.left.core.seal_unit(bytes(1_000_000))
    before = core.deadline()
    assert begins(w.right) is False
    core.receive_data(next(begun), NOW)
    assert begins(w.right) is True
    assert core.deadline() == NOW + STEP
    for second in range(0, 10 * WINDOW, STEP):
        core.tick(NOW + second, reading=False)
        assert core.deadline() == NOW + second + STEP
    start = NOW + 10 * WINDOW
    for second in range(0, WINDOW - STEP, STEP):
        core.tick(start + second)
    core.receive_data(next(begun), start + WINDOW)
    for record in begun:
        core.receive_data(record, start + 2 * WINDOW)
    assert begins(w.right) is False
    assert core.deadline() == before
    core.receive_data(next(w.left.core.seal_unit(bytes(1_000_000))), start)
    with pytest.raises(LimitExceeded, match="not whole after 60 seconds"):  # noqa: PT012 - at last
        for second in range(0, 2 * WINDOW, STEP):
            core.tick(start + second)
    assert core.deadline() is None
    assert core.state is ConnectionState.CLOSED


def test_a_unit_that_arrives_too_slowly_is_refused() -> None:
    w = joined(right=bob())
    core = w.right.core
    with pytest.raises(LimitExceeded, match="not whole after 600 seconds"):  # noqa: PT012 - at last
        for second, record in enumerate(w.left.core.seal_unit(bytes(200 * 1024 * 1024))):
            core.receive_data(record, NOW + second)


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
    assert core.receive_data(b"whatever", NOW) == []


def test_the_close_in_the_middle_of_a_unit_is_a_truncation() -> None:
    w = joined()
    records = w.left.core.seal_unit(b"x" * 600_000)
    w.right.give(bytes(next(records)))
    w.left.core.close()
    with pytest.raises(ChannelClosed):
        next(records)
    assert isinstance(w.pump().right.error, ConnectionTruncated)
    assert w.right.units == []


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


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_end_without_close_is_a_truncation(side: str) -> None:
    end: End = getattr(joined(), side)
    with pytest.raises(ConnectionTruncated, match="without the peer's close"):
        end.core.receive_eof()
    assert end.core.deadline() is None


def test_the_end_during_the_handshake() -> None:
    with pytest.raises(HandshakeFailed, match="during the handshake"):
        alice().receive_eof()


def test_a_forged_record_ends_the_connection_for_ever() -> None:
    w = joined()
    w.left.core.send_unit(b"x")
    record = w.left.take()
    w.right.give(record[:-1] + bytes([record[-1] ^ 1]))
    assert isinstance(w.right.error, RecordForged)
    assert w.right.core.receive_data(record, NOW) == []
    with pytest.raises(ChannelError):
        w.right.core.send_unit(b"y")
    assert w.right.take() == b""


def test_secrets_do_not_appear_in_representations() -> None:
    w: Wire = joined()
    session = w.left.core._session
    assert session is not None
    assert repr(session._epochs._exporter) == "Exporter(...)"
    with pytest.raises(HandshakeFailed):  # an open connection needs it no more
        _ = w.left.core._negotiation._edhoc.exporter


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


def test_the_socket_writes_into_the_buffer_of_the_connection() -> None:
    left, right = alice(), bob()
    queued = [left.has_data_to_send]
    flight = left.data_to_send()
    queued.append(left.has_data_to_send)
    assert queued == [True, False]
    right.get_buffer()[: len(flight)] = flight
    assert right.buffer_updated(len(flight), NOW) == []
    assert right.has_data_to_send
    assert left.unit_limit == ChannelLimits().unit


def test_an_abandoned_connection_sends_and_seals_nothing() -> None:
    """A forked process: its parent goes on with these keys and counters."""
    left = joined().left.core
    left.abandon()
    left.close()
    assert not left.has_data_to_send
    assert left.seal_small(b"x") is None
    with pytest.raises(ChannelClosed):
        left.send_unit(b"x")
