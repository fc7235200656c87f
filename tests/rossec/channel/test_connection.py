"""One connection from end to end: units, buffers, closes."""

import pytest

from rossec.channel.edhoc.suites import GONE
from rossec.channel.negotiation import Closed, ConnectionState
from rossec.channel.opening import WireProtocol
from rossec.channel.records import Bytes, ChannelLimits
from rossec.errors import ChannelClosed, ChannelError, ConnectionTruncated, HandshakeFailed, LimitExceeded
from rossec.peer_limits import STEP, WINDOW
from tests.support.wire import NOW, End, Wire, alice, bob, joined, peers, receive, wire


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


@pytest.mark.parametrize("size", [11, 300_000])
def test_a_peer_that_sends_a_unit_beyond_the_limit(size: int) -> None:
    w = joined(right=bob(limits=ChannelLimits(unit=10)))
    w.left.core.send_unit(b"x" * size)
    assert isinstance(w.pump().right.error, LimitExceeded)
    assert w.right.units == []


def begins(end: End) -> bool:
    return end.core.has_unfinished_unit


def test_an_incomplete_unit_must_make_progress() -> None:
    """Whether bytes come or not; only while this side reads; small units are begun and ended."""
    w = joined(right=bob())
    core, begun = w.right.core, w.left.core.seal_unit(bytes(1_000_000))
    before = core.deadline()
    assert begins(w.right) is False
    receive(core, next(begun), NOW)
    assert begins(w.right) is True
    assert core.deadline() == NOW + STEP
    for second in range(0, 10 * WINDOW, STEP):
        core.tick(NOW + second, reading=False)
        assert core.deadline() == NOW + second + STEP
    start = NOW + 10 * WINDOW
    for second in range(0, WINDOW - STEP, STEP):
        core.tick(start + second)
    receive(core, next(begun), start + WINDOW)
    for record in begun:
        receive(core, record, start + 2 * WINDOW)
    assert begins(w.right) is False
    assert core.deadline() == before
    receive(core, next(w.left.core.seal_unit(bytes(1_000_000))), start)
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
            receive(core, record, NOW + second)


def test_the_close_in_the_middle_of_a_unit_is_a_truncation() -> None:
    w = joined()
    records = w.left.core.seal_unit(b"x" * 600_000)
    w.right.give(bytes(next(records)))
    w.left.core.close()
    with pytest.raises(ChannelClosed):
        next(records)
    assert isinstance(w.pump().right.error, ConnectionTruncated)
    assert w.right.units == []


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
    assert isinstance(w.right.error, ChannelError)
    assert "does not verify" in str(w.right.error)
    assert receive(w.right.core, record, NOW) == []
    with pytest.raises(ChannelError):
        w.right.core.send_unit(b"y")
    assert w.right.take() == b""


def test_secrets_do_not_appear_in_representations() -> None:
    w: Wire = joined()
    session = w.left.core._session
    assert session is not None
    assert repr(session._epochs._exporter) == "Exporter(...)"


def test_an_open_connection_keeps_nothing_of_its_handshake() -> None:
    w: Wire = wire(alice(), bob())
    steps = [end.core._negotiation for end in (w.left, w.right)]
    w.pump()
    for end, each in zip((w.left, w.right), steps, strict=True):
        assert end.core._negotiation is None
        assert each is not None
        with pytest.raises(HandshakeFailed):
            _ = each._edhoc.exporter
        assert each._edhoc._prk is GONE


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
