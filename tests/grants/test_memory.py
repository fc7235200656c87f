"""What a limited right remembers: rates, cells, and that nobody gains by being forgotten."""

import gc
from types import SimpleNamespace
from typing import Any

import pytest

from grants.decision import Decision
from grants.errors import MemoryExhausted
from grants.memory import Memory, MemoryScope, MemoryStore
from grants.model import Right


def decision(holder: int = 1, name: str = "/a", right: Right = Right.SUBSCRIBE) -> Decision:
    grant: Any = SimpleNamespace(holder=bytes([holder]) * 32)
    return Decision(right, name, (grant, grant), 100, ())


def passes(memory: Memory, rate: float, now: int, mark: object = None) -> bool:
    return memory.take(memory.bucket(rate), object() if mark is None else mark, now)


def test_a_message_counts_once() -> None:
    memory, mark = Memory(), object()
    assert [passes(memory, 1, 0, mark) for _ in range(3)] == [True] * 3
    assert not passes(memory, 1, 0)
    assert passes(memory, 1, 1)
    assert not passes(memory, 1, 1, mark), "another one was let through since"


def test_rates_of_one_key_let_through_no_more_than_the_widest() -> None:
    memory = Memory()
    narrow, wide = memory.bucket(0.2), memory.bucket(1)
    passed = [
        memory.take(bucket, object(), now) for now in range(20) for bucket in (narrow, wide, narrow)
    ]
    assert sum(passed) == 20
    mark = object()
    assert [memory.take(bucket, mark, 90) for bucket in (narrow, wide)] == [True, True]


def test_a_further_rate_begins_with_what_is_left() -> None:
    memory = Memory()
    assert passes(memory, 2, 0)
    assert passes(memory, 4, 0), "of two tokens there was one"
    assert not passes(memory, 4, 0)
    assert not passes(memory, 8, 0)
    fresh = Memory()
    assert [passes(fresh, 2.5, 0) for _ in range(3)] == [True, True, False]


def test_ready() -> None:
    memory = Memory()
    bucket = memory.bucket(0.5)
    assert memory.ready(bucket, 0)
    assert memory.take(bucket, object(), 0)
    assert [memory.ready(bucket, now) for now in (0, 1, 2)] == [False, False, True]


def test_recovery() -> None:
    memory = Memory()
    assert memory.recovered(0)
    assert passes(memory, 0.5, 10)
    assert [memory.recovered(now) for now in (10, 11, 12)] == [False, False, True]
    cell = memory.cell(("x", 1))
    assert memory.recovered(10_000), "nothing was rounded yet"
    cell.held = 0.0
    assert not memory.recovered(20_000), "an anchor is for good"


def test_one_memory_has_bounds() -> None:
    memory = Memory()
    for rate in range(1, 65):
        memory.bucket(rate)
    with pytest.raises(MemoryExhausted, match="64 rates are remembered already") as caught:
        memory.bucket(65)
    assert "wait until the rates" in caught.value.hint
    for number in range(4096):
        memory.cell((number,))
    with pytest.raises(MemoryExhausted, match="4096 fields with hysteresis"):
        memory.cell(("more",))
    assert memory.cell((0,)) is memory.cell((0,))


def test_whose_it_is() -> None:
    recall = MemoryScope(MemoryStore(lambda: 0), ("/node",))
    memory = recall(decision())
    assert recall(decision()) is memory
    others = [
        recall(decision(2)), recall(decision(name="/b")), recall(decision(right=Right.PUBLISH)),
        recall.child("response")(decision()), MemoryScope(recall.memories, ("/other",))(decision()),
    ]  # fmt: skip
    assert len({memory, *others}) == 6
    assert len(recall.memories) == 6


def test_what_has_recovered_gives_way_and_nothing_else() -> None:
    now = [0]
    recall = MemoryScope(MemoryStore(lambda: now[0], most=2), ("/node",))
    assert passes(recall(decision(1)), 0.5, 0)
    recall(decision(2)).cell(("x",)).held = 0.0
    for _ in range(2):
        with pytest.raises(MemoryExhausted, match="2 limited rights are remembered already"):
            recall(decision(3))
    now[0] = 2
    recall(decision(3))
    assert len(recall.memories) == 2
    with pytest.raises(MemoryExhausted):
        recall(decision(1))


def test_what_is_used_is_not_forgotten() -> None:
    """Else a holder that has others fill the memory would begin anew when it comes back."""
    now = [10]
    recall = MemoryScope(MemoryStore(lambda: now[0], most=1), ("/node",))
    used = recall(decision(1))
    cell = used.cell(("x",))
    with pytest.raises(MemoryExhausted, match="1 limited rights are remembered already"):
        recall(decision(2))
    assert passes(used, 0.5, 10)
    cell.held = 4.0
    del used
    gc.collect()
    assert recall(decision(1)).cell(("x",)) is cell
    now[0] += 100
    with pytest.raises(MemoryExhausted):
        recall(decision(2))


def test_what_nobody_uses_and_holds_nothing_gives_way() -> None:
    recall = MemoryScope(MemoryStore(lambda: 0, most=1), ("/node",))
    recall(decision(1)).cell(("x",))
    recall(decision(2))
    assert len(recall.memories) == 1
