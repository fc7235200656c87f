import pytest

from rossec.channel.records import HEADER, MAX_PLAINTEXT, TAG, ChannelLimits, Frame
from tests.support.wire import NOW, Wire, alice, bob, joined

RECORD = HEADER + MAX_PLAINTEXT + TAG


def send(wire: Wire, unit: bytes) -> list[int]:
    """Send a unit with shared buffers; how long each write was."""
    lengths = []
    for written in wire.left.core.seal_unit(unit, reuse=True):
        lengths.append(len(written))
        wire.right.give(bytes(written))
        wire.left.give(wire.right.take())
    return lengths


def test_nothing_is_renewed_before_its_time() -> None:
    w = joined(left=alice(limits=ChannelLimits(seconds=100)), right=bob())
    session = w.left.core._open_session()
    session.seal_small(b"used")
    assert session.renew(NOW + 99) == b""
    assert session.renew(NOW + 100) != b""


def test_large_records_may_share_one_buffer() -> None:
    w = joined()
    unit = bytes(range(256)) * 3000
    session, buffers = w.left.core._open_session(), []
    for _ in range(2):
        for record in w.left.core.seal_unit(unit, reuse=True):
            w.right.give(bytes(record))
        buffers.append(session._scratch)
    assert w.right.units == [unit, unit]
    assert buffers[0] is buffers[1] is not None


def test_large_records_share_a_buffer_and_go_out_together() -> None:
    w = joined()
    units = [bytes([number]) * (5 * MAX_PLAINTEXT + 10) for number in range(3)]
    for unit in units:
        assert send(w, unit) == [4 * RECORD, RECORD + HEADER + 10 + TAG]
    assert w.right.units == units


def test_small_units_go_out_alone() -> None:
    w = joined()
    assert send(w, b"small") == [HEADER + 5 + TAG]
    assert w.right.units == [b"small"]


def test_a_renewal_comes_between_records_that_go_out_together() -> None:
    limits = ChannelLimits(records=3)
    w = joined(left=alice(limits=limits), right=bob(limits=limits))
    unit = bytes(8 * MAX_PLAINTEXT)
    lengths = send(w, unit)
    assert sum(lengths) == 8 * RECORD + 2 * (HEADER + TAG)
    assert w.right.units == [unit]


def test_a_side_that_renewed_awaits_its_peer() -> None:
    limits = ChannelLimits(seconds=10)
    w = joined(left=alice(limits=limits))
    seen = [w.left.core.awaits_peer]
    w.left.core.send_unit(b"x")
    w.left.core.tick(NOW + 10)
    seen.append(w.left.core.awaits_peer)
    w.pump()
    seen.append(w.left.core.awaits_peer)
    w.left.core.close()
    assert [*seen, w.left.core.awaits_peer] == [False, True, False, False]


@pytest.mark.parametrize("size", [1, 63, 64, 20_000, MAX_PLAINTEXT - 1, MAX_PLAINTEXT, 700_001])
@pytest.mark.parametrize("reuse", [False, True])
def test_a_side_pads_what_it_sends(size: int, reuse: bool) -> None:
    w = joined()
    w.left.core.pad_units(4096)
    unit = bytes([7]) * size
    small = w.left.core.seal_small(unit) if size <= 64 * 1024 else None
    records = [small] if small else list(map(bytes, w.left.core.seal_unit(unit, reuse=reuse)))
    sent = b"".join(map(bytes, records))
    count = -(-(size + 1) // MAX_PLAINTEXT) if size % MAX_PLAINTEXT else size // MAX_PLAINTEXT
    assert (len(sent) - count * (HEADER + TAG)) % 4096 == 0
    w.right.give(sent)
    assert w.right.units == [unit]
    w.right.core.send_unit(b"back")
    assert len(w.right.take()) == HEADER + 4 + TAG, "the other side does not"


def test_a_record_that_belongs_to_no_unit_leaves_the_unit_alone() -> None:
    w = joined()
    sender, receiver = w.left.core._open_session(), w.right.core._open_session()
    first, last = sender.seal_unit([bytes(MAX_PLAINTEXT), b"end"], reuse=False)
    renewal = bytes(sender.seal_renewal(Frame.GRANTS, b"grants"))
    w.right.give(bytes(first))
    w.right.give(bytes(last))
    found = receiver.open_renewal(renewal[:HEADER], memoryview(renewal)[HEADER:])
    assert (found, w.right.units) == (b"grants", [bytes(MAX_PLAINTEXT) + b"end"])
