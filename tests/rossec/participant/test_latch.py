"""What a latching publisher sends to a new subscriber."""

import struct

from grants.decision import Decision
from grants.guard import Guard, Memory
from grants.model import Restriction, Right
from rossec.participant.delivery_options import Latch, Sample

NOW = 1_800_000_000


def guard(memory: Memory | None) -> Guard:
    restrictions = () if memory is None else (Restriction(rate=0.1),)
    decision = Decision(Right.SUBSCRIBE, "/a", (), NOW + 100, restrictions)
    return Guard(None, decision, None, lambda _: memory or Memory())


def latched(latch: Latch[bytes], receiver: Guard, now: int = NOW) -> bytes | None:
    """What a new subscriber receives."""
    for sample in latch.candidates(receiver):
        if receiver.apply(sample.data, now, sample.mark) is not None:
            latch.record(receiver, sample)
            return sample.data
    return None


def test_a_new_subscriber_receives_the_newest_message_or_the_last_one_it_received() -> None:
    latch: Latch[bytes] = Latch()
    memory, other = Memory(), Memory()
    assert latched(latch, guard(memory)) is None
    for number in range(3):
        latch.newest = Sample(struct.pack("<I", number))
        assert latched(latch, guard(memory)) == struct.pack("<I", 0)
        assert latched(latch, guard(None)) == latch.newest.data
    assert latched(latch, guard(other)) == struct.pack("<I", 2)
    assert latched(latch, guard(memory), NOW + 10) == struct.pack("<I", 2)
