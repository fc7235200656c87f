"""State of limited rights: rates, hysteresis, and that eviction gains no peer anything."""

import gc
from types import SimpleNamespace
from typing import Any

import pytest

from grants.decision import Decision
from grants.errors import MemoryExhausted
from grants.memory import Memory, MemoryScope, MemoryStore
from grants.model import Right


def decision(holder: int = 1, name: str = "/a", right: Right = Right.SUBSCRIBE) -> Decision:
    grant: Any = SimpleNamespace(holder=bytes([holder]) * 32, chain=())
    grant.links = (grant,)
    return Decision(right, name, (grant, grant), 100, ())


def admitted(memory: Memory, rate: float, now: int, message_id: object = None) -> bool:
    return memory.take(memory.bucket(rate), object() if message_id is None else message_id, now)


def test_a_message_counts_once() -> None:
    memory, message_id = Memory(), object()
    assert [admitted(memory, 1, 0, message_id) for _ in range(3)] == [True] * 3
    assert not admitted(memory, 1, 0)
    assert admitted(memory, 1, 1)
    assert not admitted(memory, 1, 1, message_id), "another message was admitted since"


def test_rates_of_one_key_admit_no_more_than_the_highest() -> None:
    memory = Memory()
    narrow, wide = memory.bucket(0.2), memory.bucket(1)
    passed = [
        memory.take(bucket, object(), now) for now in range(20) for bucket in (narrow, wide, narrow)
    ]
    assert sum(passed) == 20
    message_id = object()
    assert [memory.take(bucket, message_id, 90) for bucket in (narrow, wide)] == [True, True]


def test_another_rate_starts_with_the_remaining_tokens() -> None:
    memory = Memory()
    assert admitted(memory, 2, 0)
    assert admitted(memory, 4, 0), "one of two tokens was left"
    assert not admitted(memory, 4, 0)
    assert not admitted(memory, 8, 0)
    fresh = Memory()
    assert [admitted(fresh, 2.5, 0) for _ in range(3)] == [True, True, False]


def test_a_bucket_is_ready_when_a_token_is_available() -> None:
    memory = Memory()
    bucket = memory.bucket(0.5)
    assert bucket.refill(0)
    assert memory.take(bucket, object(), 0)
    assert [bucket.refill(now) for now in (0, 1, 2)] == [False, False, True]


def test_a_memory_is_fresh_when_its_buckets_are_full_and_no_value_is_stored() -> None:
    memory = Memory()
    assert memory.is_fresh(0)
    assert admitted(memory, 0.5, 10)
    assert [memory.is_fresh(now) for now in (10, 11, 12)] == [False, False, True]
    state = memory.hysteresis(("x", 1))
    assert memory.is_fresh(10_000), "nothing was rounded yet"
    state.value = 0.0
    assert not memory.is_fresh(20_000), "a stored value never expires"


def test_one_memory_is_bounded() -> None:
    memory = Memory()
    for rate in range(1, 65):
        memory.bucket(rate)
    with pytest.raises(MemoryExhausted, match="64 rates are stored already") as caught:
        memory.bucket(65)
    assert "wait until the rates" in caught.value.hint
    for number in range(4096):
        memory.hysteresis((number,))
    with pytest.raises(MemoryExhausted, match="4096 fields with hysteresis"):
        memory.hysteresis(("more",))
    assert memory.hysteresis((0,)) is memory.hysteresis((0,))


def test_memories_are_separate_by_scope_key_right_and_name() -> None:
    scope = MemoryScope(MemoryStore(lambda: 0), ("/node",))
    memory = scope(decision())
    assert scope(decision()) is memory
    others = [
        scope(decision(2)), scope(decision(name="/b")), scope(decision(right=Right.PUBLISH)),
        scope.child("response")(decision()), MemoryScope(scope.store, ("/other",))(decision()),
    ]  # fmt: skip
    assert len({memory, *others}) == 6
    assert len(scope.store) == 6


def test_only_fresh_memories_are_evicted() -> None:
    now = [0]
    scope = MemoryScope(MemoryStore(lambda: now[0], limit=2), ("/node",))
    assert admitted(scope(decision(1)), 0.5, 0)
    scope(decision(2)).hysteresis(("x",)).value = 0.0
    for _ in range(2):
        with pytest.raises(MemoryExhausted, match="2 limited rights are stored already"):
            scope(decision(3))
    now[0] = 2
    scope(decision(3))
    assert len(scope.store) == 2
    with pytest.raises(MemoryExhausted):
        scope(decision(1))


def test_memories_in_use_are_not_evicted() -> None:
    """Otherwise a holder could have others fill the store and reconnect with fresh state."""
    now = [10]
    scope = MemoryScope(MemoryStore(lambda: now[0], limit=1), ("/node",))
    used = scope(decision(1))
    state = used.hysteresis(("x",))
    with pytest.raises(MemoryExhausted, match="1 limited rights are stored already"):
        scope(decision(2))
    assert admitted(used, 0.5, 10)
    state.value = 4.0
    del used
    gc.collect()
    assert scope(decision(1)).hysteresis(("x",)) is state
    now[0] += 100
    with pytest.raises(MemoryExhausted):
        scope(decision(2))


def test_an_unused_memory_without_values_is_evicted() -> None:
    scope = MemoryScope(MemoryStore(lambda: 0, limit=1), ("/node",))
    scope(decision(1)).hysteresis(("x",))
    scope(decision(2))
    assert len(scope.store) == 1
