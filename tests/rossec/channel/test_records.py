import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rossec.channel.edhoc.suites import SUITES, EdhocExporter
from rossec.channel.records import (
    MAX_PLAINTEXT,
    TAG,
    Bytes,
    Direction,
    Epochs,
    Frame,
    check_header,
    fragments,
    frame,
    header,
    padded,
    unpadded,
)
from rossec.errors import ChannelError, ConnectionTruncated, LimitExceeded, ProtocolViolation
from tests.support.wire import Wire, alice, bob, joined

EXPORTER = EdhocExporter(bytes(32))


def direction(suite: int = 6, epoch: int = 0) -> Direction:
    return Direction(SUITES[suite], EXPORTER, 32768, epoch)


def opened(receiver: Direction, record: Bytes) -> bytes:
    return receiver.open(bytes(record[:4]), memoryview(record)[4:])


@pytest.mark.parametrize("suite", [4, 6])
@pytest.mark.parametrize("size", [0, 1, 4095, 4096, MAX_PLAINTEXT])
def test_what_is_sealed_opens(suite: int, size: int) -> None:
    sender, receiver = direction(suite), direction(suite)
    for _ in range(3):
        record = sender.seal(Frame.DATA, b"x" * size)
        assert len(record) == 4 + size + TAG
        assert opened(receiver, record) == b"x" * size
    assert (sender.records, sender.octets) == (3, 3 * size) == (receiver.records, receiver.octets)


def test_no_two_records_are_alike() -> None:
    sender = direction()
    assert len({bytes(sender.seal(Frame.DATA, b"same")) for _ in range(100)}) == 100
    keys = {bytes(direction(epoch=epoch).seal(Frame.DATA, b"same"))[4:] for epoch in range(100)}
    assert len(keys) == 100


def test_the_short_tags_of_suite_0_carry_no_records() -> None:
    with pytest.raises(ProtocolViolation, match="no record layer"):
        direction(suite=0)


def test_the_counter_never_wraps() -> None:
    sender = direction()
    sender.records = 1 << 48
    with pytest.raises(LimitExceeded, match="used up"):
        sender.seal(Frame.DATA, b"x")


def test_a_counter_is_consumed_by_a_failure_too() -> None:
    sender, receiver = direction(), direction()
    record = sender.seal(Frame.DATA, b"x")
    with pytest.raises(ChannelError, match="does not verify"):
        opened(receiver, bytes(record[:-1]) + b"\0")
    with pytest.raises(ChannelError, match="does not verify"):
        opened(receiver, record)


# -- headers


def test_the_bytes_of_a_header() -> None:
    assert header(Frame.DATA_END, 0x12, 0x030405) == bytes.fromhex("42030405")
    assert frame(Frame.HANDSHAKE, b"abc") == bytes.fromhex("10000003616263")


@pytest.mark.parametrize(
    ("kind", "shortest", "longest"),
    [
        (Frame.HANDSHAKE, 1, 16384),
        (Frame.ERROR, 1, 1024),
        (Frame.DATA, TAG + 1, MAX_PLAINTEXT + TAG),
        (Frame.DATA_END, TAG + 1, MAX_PLAINTEXT + TAG),
        (Frame.REKEY, TAG, TAG),
        (Frame.CLOSE, TAG, TAG),
    ],
)
def test_lengths_are_checked_before_anything_is_buffered(kind: Frame, shortest: int, longest: int) -> None:
    check_header(header(kind, 17, shortest), 1)
    check_header(header(kind, 1, longest), 17)
    for length in (shortest - 1, longest + 1, 0xFFFFFF):
        with pytest.raises(ProtocolViolation, match="forbidden length"):
            check_header(header(kind, 1, length), 1)
    with pytest.raises(ProtocolViolation, match="another epoch"):
        check_header(header(kind, 1, shortest), 2)


# -- epochs


def test_keys_come_when_they_are_asked_for_and_nothing_else_does(monkeypatch: pytest.MonkeyPatch) -> None:
    derived, derive = list[int](), Epochs._derive

    def noted(epochs: Epochs, epoch: int) -> tuple[Direction, Direction]:
        derived.append(epoch)
        return derive(epochs, epoch)

    monkeypatch.setattr(Epochs, "_derive", noted)
    left, right = sides()
    assert derived == []
    assert right.receiver.epoch == left.sender.epoch == 0
    assert left.receiver.epoch == right.sender.epoch == 0
    assert derived == [0, 0]
    with pytest.raises(AttributeError, match="keys"):
        left.keys  # noqa: B018 - asking is the test


def sides() -> tuple[Epochs, Epochs]:
    suite = SUITES[6]
    return Epochs(suite, EXPORTER, initiator=True), Epochs(suite, EXPORTER, initiator=False)


def agree(left: Epochs, right: Epochs) -> None:
    for sender, receiver in ((left.sender, right.receiver), (right.sender, left.receiver)):
        assert sender.epoch == receiver.epoch
        assert opened(receiver, sender.seal(Frame.DATA_END, b"x")) == b"x"


def test_the_directions_move_on_one_by_one() -> None:
    left, right = sides()
    for _ in range(20):
        agree(left, right)
        agree(left, right)
        left.next_sender()
        right.next_receiver()
        agree(left, right)
        with pytest.raises(ProtocolViolation, match="second rekey"):
            left.next_sender()
        with pytest.raises(ProtocolViolation, match="twice in a row"):
            right.next_receiver()
        right.next_sender()
        left.next_receiver()
    agree(left, right)
    assert left.sender.epoch == 20


def test_both_may_begin_at_once() -> None:
    left, right = sides()
    agree(left, right)
    left.next_sender()
    right.next_sender()
    left.next_receiver()
    right.next_receiver()
    agree(left, right)


def test_the_directions_have_keys_of_their_own() -> None:
    left, _ = sides()
    record = left.sender.seal(Frame.DATA_END, b"x")
    with pytest.raises(ChannelError, match="does not verify"):
        opened(left.receiver, record)  # reflected


def test_unused_keys_are_not_renewed() -> None:
    _, right = sides()
    with pytest.raises(ProtocolViolation, match="has not used"):
        right.next_receiver()


# -- units


@given(st.binary(min_size=1, max_size=600), st.integers(32, 300))
def test_padding_comes_off(data: bytes, multiple: int) -> None:
    longer = padded(data, multiple)
    assert longer is not None
    assert len(longer) % multiple == 0
    assert len(data) < len(longer) <= len(data) + multiple
    assert unpadded(longer) == data


def test_padding_never_makes_a_record_too_long() -> None:
    assert padded(bytes(MAX_PLAINTEXT), 64) is None
    for left in (1, 2, 63):
        assert len(padded(bytes(MAX_PLAINTEXT - left), 4099) or b"") == MAX_PLAINTEXT


@pytest.mark.parametrize("plaintext", [b"", b"\0", b"\1", b"\1\0", bytes(300), b"x\2\0", b"x"])
def test_padding_without_data_or_end_is_refused(plaintext: bytes) -> None:
    with pytest.raises(ProtocolViolation, match="padded record"):
        unpadded(plaintext)


SIZES = st.one_of(st.integers(0, 100), st.integers(16_000, 17_000), st.integers(260_000, 600_000))


@settings(deadline=None, max_examples=50)
@given(st.lists(SIZES, max_size=12))
def test_fragments_lose_nothing(sizes: list[int]) -> None:
    pieces = [bytes([number]) * size for number, size in enumerate(sizes)]
    cut = list(fragments(pieces))
    assert b"".join(cut) == b"".join(pieces)
    assert all(0 < len(part) <= MAX_PLAINTEXT for part in cut)


@settings(deadline=None, max_examples=25)
@given(st.lists(st.lists(SIZES, max_size=4), max_size=4), st.sampled_from([0, 4099, 300_000]))
def test_units_of_any_shape_arrive_as_sent(units: list[list[int]], step: int) -> None:
    w = joined()
    w.step = step
    sent = [[b"z" * size for size in sizes] for sizes in units]
    for pieces in sent:
        w.left.core.send_unit(*pieces)
    w.pump()
    assert w.right.units == [unit for pieces in sent if (unit := b"".join(pieces))]


# -- a short stream of records, damaged in every way


def stream() -> tuple[Wire, list[bytes]]:
    """A connection and four records not yet delivered: a unit, a unit of two, the close."""
    w = joined(left=alice(), right=bob())
    w.left.core.send_unit(b"one")
    first = w.left.take()
    second = [bytes(record) for record in w.left.core.seal_unit(b"t" * 20_000, b"wo")]
    w.left.core.close()
    return w, [first, *second, w.left.take()]


@pytest.mark.parametrize("number", range(4))
def test_every_flipped_bit_of_a_record_stream_ends_it(number: int) -> None:
    length = len(stream()[1][number])
    for position in range(length) if length < 64 else (0, 1, 2, 3, 4, 9999, -16, -1):
        for bit in range(8):
            w, records = stream()  # signatures differ from run to run, so do the keys
            damaged = bytearray(records[number])
            damaged[position] ^= 1 << bit
            w.right.give(b"".join(records[:number]))
            w.right.give(bytes(damaged) + b"".join(records[number + 1 :]))
            if w.right.error is None:  # a longer length: it waits for what never comes
                with pytest.raises(ConnectionTruncated):
                    w.right.core.receive_eof()
            assert w.right.units == [b"one", b"t" * 20_000 + b"wo"][: (0, 1, 1, 2)[number]]
            assert w.right.take() == b""


@pytest.mark.parametrize(
    "order",
    [
        [0, 0],  # replayed
        [1],  # left out
        [0, 2],
        [0, 2, 1],  # reordered
        [0, 1, 1],
        [0, 1, 3],  # closed in the middle
        [3],
    ],
)
def test_replayed_reordered_and_missing_records(order: list[int]) -> None:
    w, records = stream()
    for number in order:
        w.right.give(records[number])
    assert w.right.error is not None
    assert w.right.units == ([b"one"] if order[0] == 0 else [])
    assert w.right.take() == b""


def test_reflected_records() -> None:
    w = joined()
    w.left.core.send_unit(b"one")
    record = w.left.take()
    w.left.give(record)
    assert isinstance(w.left.error, ChannelError)
    assert "does not verify" in str(w.left.error)
