"""Copies of one message for the connections of a key."""

from contextlib import ExitStack

from grants.decision import Decision
from grants.filters.layout import Buffer
from grants.guard import Guard, Memory
from grants.model import Restriction, Right
from rossec.sidecar.core.guards import CopyTracker, MessageGuard, ReplaceableGuard

NOW = 1_800_000_000


def make_guard(memory: Memory | None, *conditions: str) -> Guard:
    limits = () if memory is None else (Restriction(None, conditions, rate=0.1),)
    decision = Decision(Right.SUBSCRIBE, "/a", (), NOW + 100, limits)
    return Guard(None, decision, None, lambda _: memory or Memory())


class Connections:
    """The connections of one key."""

    def __init__(self, stack: ExitStack, *, latching: bool = False) -> None:
        self.stack = stack
        self.copies = CopyTracker()
        self.memory = Memory()
        self.latching = latching

    def open(self, now: int = NOW) -> tuple[MessageGuard, list[Buffer]]:
        shared = self.copies.share(make_guard(self.memory), now, latching=self.latching)
        guard, initial = self.stack.enter_context(shared)
        assert guard is not None
        return guard, initial


def test_a_guard_without_memory_is_not_shared() -> None:
    with CopyTracker().share(None, NOW, latching=False) as found:
        assert found == (None, [])
    alone = make_guard(None)
    with CopyTracker().share(alone, NOW, latching=True) as found:
        guard, initial = found
        assert isinstance(guard, ReplaceableGuard)
        assert (guard.apply, initial) == (alone.apply, [])


def test_a_copy_passes_once_on_each_connection_that_was_open() -> None:
    with ExitStack() as stack:
        connections = Connections(stack)
        one, two, three = (connections.open()[0] for _ in range(3))
        for guard in (one, two, three):
            guard.check(NOW)
        assert one.apply(b"a", NOW) == [b"a"]
        assert one.apply(b"a", NOW) is None
        assert two.apply(b"b", NOW) is None
        assert two.apply(b"a", NOW + 1) == [b"a"]
        assert two.apply(b"a", NOW + 1) is None
        late, initial = connections.open()
        assert initial == []
        assert late.apply(b"a", NOW) is None
        assert three.apply(b"a", NOW + 2) is None, "it may be a new message by now"


def test_a_new_connection_to_a_latching_program_gets_the_last_message() -> None:
    with ExitStack() as stack:
        connections = Connections(stack, latching=True)
        first, initial = connections.open()
        assert initial == []
        assert first.apply(b"a", NOW) == [b"a"]
        second, initial = connections.open(NOW + 5)
        assert initial == [b"a"]
        assert second.apply(b"b", NOW + 5) is None
        third, initial = connections.open(NOW + 10)
        assert initial == []
        assert third.apply(b"b", NOW + 10) == [b"b"]


def test_the_last_message_is_kept_only_if_latching() -> None:
    for latching, kept in ((True, [b"a"]), (False, [])):
        with ExitStack() as stack:
            connections = Connections(stack, latching=latching)
            assert connections.open()[0].apply(b"a", NOW) == [b"a"]
        with ExitStack() as stack:
            connections.stack = stack
            connections.latching = True
            assert connections.open()[1] == kept
