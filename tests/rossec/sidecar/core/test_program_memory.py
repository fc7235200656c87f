"""Memories of limits for programs behind a sidecar."""

from grants.guard import MemoryScope, MemoryStore
from rossec.sidecar.core.guards import ProgramMemories

SCOPE = MemoryScope(MemoryStore(lambda: 0), ("/robot",))


def test_a_program_keeps_its_memory() -> None:
    ended: set[int] = set()
    memories = ProgramMemories[int](SCOPE, ended.__contains__)
    first, second = SCOPE.child("0"), SCOPE.child("1")
    assert memories.acquire("/a", 1) == first
    assert memories.acquire("/b", 2) == second, "both run"
    assert [memories.acquire(name, 1) for name in ("/a", "/c")] == [first] * 2, "whatever its name"
    ended |= {1, 2}
    assert memories.acquire("/b", 3) == second, "found by its name"
    assert memories.acquire("/a", 4) == first


def test_there_are_as_many_memories_as_running_programs() -> None:
    """Not as many as names: `rostopic pub` uses a new name in each run."""
    ended: set[int] = set()
    memories = ProgramMemories[int](SCOPE, ended.__contains__)
    assert memories.acquire("/robot", 0) == SCOPE.child("0")
    for number in range(1, 50):
        assert memories.acquire(f"/rostopic_{number}_1700000000000", number) == SCOPE.child("1")
        ended.add(number)


def test_a_memory_is_free_when_all_its_holders_have_released_it() -> None:
    memories = ProgramMemories[str](SCOPE)
    assert memories.acquire("/a", "one") == memories.acquire("/a", "two") == SCOPE.child("0")
    memories.release("one")
    assert memories.acquire("/b", "three") == SCOPE.child("1")
    memories.release("two")
    assert memories.acquire("/c", "four") == SCOPE.child("0")
