"""The unit being received: whole, never written to while held, bounded, padding taken off."""

import pytest

from rossec.channel.records import Direction, Frame, fragments, padded
from rossec.channel.session import UnitAssembly
from rossec.errors import ChannelError, LimitExceeded, ProtocolViolation
from tests.rossec.channel.test_records import direction


def test_a_unit_comes_out_whole_and_the_next_begins_afresh() -> None:
    sender, receiver = direction(), direction()
    unit = UnitAssembly(10_000_000)
    for size in (3_000_000, 10, 3_000_000, 700_000):
        parts = list(fragments([b"x" * size]))
        for part in parts[:-1]:
            record = bytes(sender.seal(Frame.DATA, part))
            unit.add(receiver, record[:4], memoryview(record)[4:])
        record = bytes(sender.seal(Frame.DATA_END, parts[-1]))
        assert unit.finish(receiver, record[:4], memoryview(record)[4:]) == b"x" * size
        assert unit.length == 0


def test_a_unit_that_is_held_is_never_written_to() -> None:
    """The memory of units is reused once there is no other reference."""
    unit, sender, receiver = UnitAssembly(100_000_000), direction(), direction()

    def take(*parts: bytes) -> bytes:
        done = None
        for number, part in enumerate(parts):
            record = memoryview(sender.seal(Frame.DATA, part))
            last = number == len(parts) - 1
            done = (unit.finish if last else unit.add)(receiver, bytes(record[:4]), record[4:])
        assert done is not None
        return done

    parts = [bytes([letter]) * 100_000 for letter in range(20)]
    held = [take(part, part) for part in parts[:6]]
    views = [memoryview(take(part, part)) for part in parts[6:12]]
    for length in (1, 50_000, 100_000):
        for part in parts[12:]:
            assert take(part, part[:length]) == part + part[:length]
    large = take(*parts * 9)
    assert large == b"".join(parts * 9)
    assert take(b"a", b"b") == b"ab"
    assert held == [part * 2 for part in parts[:6]]
    assert views == [part * 2 for part in parts[6:12]]


def test_a_forged_part_is_not_part_of_the_unit() -> None:
    unit = UnitAssembly(1000)
    with pytest.raises(ChannelError, match="does not verify"):
        unit.add(direction(), b"\x30\0\0\x20", memoryview(bytes(32)))
    assert unit.length == 0


def test_a_unit_beyond_the_limit() -> None:
    unit = UnitAssembly(10)
    record = bytes(direction().seal(Frame.DATA, b"x" * 11))
    for take in (unit.add, unit.finish):
        with pytest.raises(LimitExceeded, match="more than 10 bytes"):
            take(direction(), record[:4], memoryview(record)[4:])


def sealed(sender: Direction, kind: Frame, plaintext: bytes) -> tuple[bytes, memoryview]:
    record = bytes(sender.seal(kind, plaintext))
    return record[:4], memoryview(record)[4:]


def test_padding_comes_off_a_unit_of_one_record_and_of_many() -> None:
    unit, sender, receiver = UnitAssembly(1000), direction(), direction()
    for begin in (b"", b"a" * 100, b"b" * 300):
        if begin:
            unit.add(receiver, *sealed(sender, Frame.DATA, begin))
        last = padded(b"end", 64)
        assert last is not None
        whole = unit.finish_padded(receiver, *sealed(sender, Frame.PADDED_END, last))
        assert whole == begin + b"end"
        assert unit.length == 0


def test_a_padded_record_has_an_end_and_a_limit() -> None:
    unit, sender, receiver = UnitAssembly(100), direction(), direction()
    with pytest.raises(ProtocolViolation, match="padded record"):
        unit.finish_padded(receiver, *sealed(sender, Frame.PADDED_END, bytes(10)))
    with pytest.raises(LimitExceeded, match="more than 100 bytes"):
        unit.finish_padded(receiver, *sealed(sender, Frame.PADDED_END, b"x\1".ljust(101, b"\0")))
    with pytest.raises(ChannelError, match="does not verify"):
        unit.finish_padded(direction(), b"\x90\0\0\x20", memoryview(bytes(32)))
