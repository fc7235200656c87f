from rossec.channel.records import HEADER, MAX_PLAINTEXT, TAG, ChannelLimits
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
    for _ in range(2):
        for record in w.left.core.seal_unit(unit, reuse=True):
            w.right.give(bytes(record))
    assert w.right.units == [unit, unit]
    session = w.left.core._open_session()
    assert session._shared_buffer() is session._shared_buffer()


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
