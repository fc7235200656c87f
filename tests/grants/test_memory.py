"""State of limited rights: rates, hysteresis, and that eviction gains no peer anything."""

import gc
from types import SimpleNamespace
from typing import Any

import pytest

from grants.decision import Decision
from grants.errors import GrantError
from grants.guard import Memory, MemoryScope, MemoryStore
from grants.model import Right

GROUP = (False, "/a")


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
    passed = [memory.take(bucket, object(), now) for now in range(20) for bucket in (narrow, wide, narrow)]
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
    state = memory.common(GROUP).hysteresis(("x", 1))
    assert memory.is_fresh(10_000), "nothing was rounded yet"
    state.value = 0.0
    assert memory.is_fresh(20_000), "what is common to others stays by itself"
    assert not memory.common(GROUP).is_fresh


def test_one_memory_is_bounded() -> None:
    memory = Memory()
    for rate in range(1, 65):
        memory.bucket(rate)
    with pytest.raises(GrantError, match="64 rates are stored already") as caught:
        memory.bucket(65)
    assert "wait until the rates" in caught.value.hint
    for number in range(4096):
        memory.common(GROUP).hysteresis((number,))
    with pytest.raises(GrantError, match="4096 fields with hysteresis"):
        memory.common(GROUP).hysteresis(("more",))
    assert memory.common(GROUP).hysteresis((0,)) is memory.common(GROUP).hysteresis((0,))


def test_memories_are_separate_by_scope_key_right_and_name() -> None:
    scope = MemoryScope(MemoryStore(lambda: 0), ("/node",))
    memory = scope(decision())
    assert scope(decision()) is memory
    others = [
        scope(decision(2)),
        scope(decision(name="/b")),
        scope(decision(right=Right.PUBLISH)),
        scope.child("response")(decision()),
        MemoryScope(scope.store, ("/other",))(decision()),
    ]
    assert len({memory, *others}) == 6
    assert len(scope.store) == 6


def test_hysteresis_is_common_to_all_holders_and_to_a_body() -> None:
    scope = MemoryScope(MemoryStore(lambda: 0), ("/node",))
    assert scope(decision(1)).common(GROUP) is scope(decision(2)).common(GROUP)
    assert scope(decision(1, "/b")).common((False, "/b")) is not scope(decision(1)).common(GROUP)
    body = (True, "robot")
    one, two = scope(decision(1, "/a")), scope(decision(2, "/b"))
    assert one.common(body) is two.common(body)
    assert one.common(body) is not one.common(GROUP)
    publishing = decision(1, right=Right.PUBLISH)
    assert scope(publishing).common(body) is not one.common(body)


def test_a_memory_is_part_of_few_bodies() -> None:
    memory = Memory()
    for number in range(64):
        memory.common((True, str(number)))
    with pytest.raises(GrantError, match="64 bodies are stored already"):
        memory.common((True, "more"))


def test_what_is_common_is_bounded_and_kept_while_a_value_is() -> None:
    scope = MemoryScope(MemoryStore(lambda: 0, limit=2), ("/node",))
    memory = scope(decision(1))
    memory.common(GROUP).hysteresis(("x",)).value = 0.0
    memory.common((False, "/unused"))
    memory.common((False, "/b")).hysteresis(("x",)).value = 0.0
    assert scope(decision(2)).common(GROUP) is memory.common(GROUP)
    with pytest.raises(GrantError, match="2 topics with hysteresis are stored already"):
        scope(decision(2)).common((False, "/c"))


def test_only_fresh_memories_are_evicted() -> None:
    now = [0]
    scope = MemoryScope(MemoryStore(lambda: now[0], limit=2), ("/node",))
    assert admitted(scope(decision(1)), 0.5, 0)
    scope(decision(2)).gate(86_400).note(object(), 0)
    for _ in range(2):
        with pytest.raises(GrantError, match="2 limited rights are stored already"):
            scope(decision(3))
    now[0] = 2
    scope(decision(3))
    assert len(scope.store) == 2
    with pytest.raises(GrantError):
        scope(decision(1))


def test_memories_in_use_are_not_evicted() -> None:
    """Otherwise a holder could have others fill the store and reconnect with fresh state."""
    now = [10]
    scope = MemoryScope(MemoryStore(lambda: now[0], limit=1), ("/node",))
    used = scope(decision(1))
    state = used.common(GROUP).hysteresis(("x",))
    with pytest.raises(GrantError, match="1 limited rights are stored already"):
        scope(decision(2))
    assert admitted(used, 0.5, 10)
    state.value = 4.0
    del used
    gc.collect()
    assert scope(decision(1)).common(GROUP).hysteresis(("x",)) is state
    now[0] += 100
    assert scope(decision(2)).common(GROUP).hysteresis(("x",)) is state, "a value never expires"


def test_an_unused_memory_without_values_is_evicted() -> None:
    scope = MemoryScope(MemoryStore(lambda: 0, limit=1), ("/node",))
    scope(decision(1)).common(GROUP).hysteresis(("x",))
    scope(decision(2))
    assert len(scope.store) == 1
