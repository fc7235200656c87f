"""Slots of half-open connections: counting, lingering, eviction."""

import gc
import socket

from rossec.net.limits import HalfOpenCount, HalfOpenLimits, HalfOpenSlot


def taken(count: HalfOpenCount, *addresses: str) -> tuple[list[HalfOpenSlot], list[str]]:
    """A place from each address, and who was closed to make room, by the name `address-number`."""
    slots, closed = [], []
    for number, address in enumerate(addresses):
        slot = count.admit(address)
        assert slot is not None
        name = f"{address}-{number}"
        slot.close = lambda name=name: closed.append(name)
        slots.append(slot)
    return slots, closed


def test_a_slot_is_counted_until_it_is_released_once() -> None:
    count = HalfOpenCount(HalfOpenLimits(per_address=1, total=2))
    (slot,), closed = taken(count, "a")
    assert count.admit("a") is None
    slot.linger()
    slot.release()
    slot.release()
    slot.linger()
    assert len(count) == 0
    assert count.admit("a") is not None
    assert closed == []


def test_the_longest_lingering_slot_of_a_source_is_evicted_first() -> None:
    count = HalfOpenCount(HalfOpenLimits(per_address=3, total=9))
    (first, second, _), closed = taken(count, "a", "a", "a")
    second.linger()
    first.linger()
    assert count.admit("a") is not None
    assert closed == ["a-1"]
    assert count.admit("a") is not None
    assert closed == ["a-1", "a-0"]
    assert count.admit("a") is None, "who is at work is not closed for its own like"
    assert len(count) == 3


def test_no_slot_is_evicted_for_a_source_at_its_cap() -> None:
    count = HalfOpenCount(HalfOpenLimits(per_address=1, total=9))
    (other, _), closed = taken(count, "b", "a")
    other.linger()
    assert count.admit("a") is None
    assert closed == []


def test_at_the_total_any_lingering_slot_is_evicted() -> None:
    count = HalfOpenCount(HalfOpenLimits(per_address=3, total=3))
    (_, late, early), closed = taken(count, "a", "b", "c")
    early.linger()
    late.linger()
    assert count.admit("d") is not None
    assert closed == ["c-2"]
    assert count.admit("d") is not None
    assert closed == ["c-2", "b-1"]
    assert len(count) == 3


def test_without_lingering_slots_the_largest_source_loses_one() -> None:
    count = HalfOpenCount(HalfOpenLimits(per_address=4, total=5))
    _, closed = taken(count, "b", "a", "a", "a", "b")
    assert count.admit("c") is not None
    assert closed == ["a-1"]
    assert len(count) == 5
    assert count.admit("c") is None, "one more than its own is no reason"


def test_a_slot_that_cannot_be_closed_is_not_evicted() -> None:
    count = HalfOpenCount(HalfOpenLimits(per_address=2, total=2))
    slots = [count.admit("a"), count.admit("a")]
    for slot in slots:
        assert slot is not None
        slot.linger()
    assert count.admit("a") is None
    assert count.admit("b") is None


def test_a_slot_is_released_when_its_socket_is_collected() -> None:
    count = HalfOpenCount(HalfOpenLimits(per_address=1, total=1))
    slot = count.admit("a")
    assert slot is not None
    sock = socket.socket()
    slot.bind(sock)
    sock.close()
    del sock
    gc.collect()
    assert len(count) == 0


def test_addresses_of_one_network_are_one_source() -> None:
    count = HalfOpenCount(HalfOpenLimits(per_address=1, total=9))
    assert count.admit("2001:db8::1") is not None
    assert count.admit("2001:db8::2") is None
    assert count.admit("2001:db8:0:1::1") is not None
