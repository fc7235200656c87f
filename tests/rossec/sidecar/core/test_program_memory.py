"""Where programs behind a sidecar remember."""

from grants.memory import MemoryScope, MemoryStore
from rossec.sidecar.core.program_memory import ProgramMemories

RECALL = MemoryScope(MemoryStore(lambda: 0), ("/robot",))


def test_a_program_has_one_place_and_keeps_it() -> None:
    gone: set[int] = set()
    memories = ProgramMemories[int](RECALL, gone.__contains__)
    first, second = RECALL.child("0"), RECALL.child("1")
    assert memories.acquire("/a", 1) == first
    assert memories.acquire("/b", 2) == second, "they live at the same time"
    assert [memories.acquire(name, 1) for name in ("/a", "/c")] == [first] * 2, "whatever it says"
    gone |= {1, 2}
    assert memories.acquire("/b", 3) == second, "each finds its own"
    assert memories.acquire("/a", 4) == first


def test_as_many_places_as_programs_at_a_time() -> None:
    """And not as many as names: `rostopic pub` has a new one in each run."""
    gone: set[int] = set()
    memories = ProgramMemories[int](RECALL, gone.__contains__)
    assert memories.acquire("/robot", 0) == RECALL.child("0")
    for number in range(1, 50):
        assert memories.acquire(f"/rostopic_{number}_1700000000000", number) == RECALL.child("1")
        gone.add(number)


def test_who_leaves_makes_room_when_all_of_its_name_have_left() -> None:
    memories = ProgramMemories[str](RECALL)
    assert memories.acquire("/a", "one") == memories.acquire("/a", "two") == RECALL.child("0")
    memories.release("one")
    assert memories.acquire("/b", "three") == RECALL.child("1")
    memories.release("two")
    assert memories.acquire("/c", "four") == RECALL.child("0")
