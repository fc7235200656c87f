"""The guards of forwarded connections: copies of a message, memory per program, renewed grants. Pure.

A program sends a copy of one message to each connection, also to those of one key: what passed once
passes on all of them. What would need another way of forwarding is refused when a grant is renewed, and
the connection is made anew.
"""

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Final, Generic, Protocol, TypeAlias, TypeVar
from weakref import WeakKeyDictionary

from grants.decision import Decision
from grants.filters.layout import Buffer
from grants.guard import Guard, Memory, MemoryScope
from rossec.errors import ConnectionHeaderRefused

WINDOW: Final = 1  # whole seconds
HolderT = TypeVar("HolderT", bound=Hashable)
Rebuild: TypeAlias = Callable[[Decision], Guard | None]


class MessageGuard(Protocol):
    """Filters the messages between a program and a peer: a guard, or one that handles copies."""

    def check(self, now: float) -> None: ...
    def apply(self, message: bytes, now: float) -> list[Buffer] | None: ...


class ReplaceableGuard:
    """A guard that another one replaces between two messages; it costs no call more than one."""

    def __init__(self, guard: Guard) -> None:
        self.check = guard.check
        self.apply: Callable[[bytes, float], list[Buffer] | None] = guard.apply

    def replace(self, guard: Guard) -> None:
        self.check, self.apply = guard.check, guard.apply


class _LastMessage:
    def __init__(self, message: bytes, mark: object, now: float, pending: set["SharedGuard"]) -> None:
        self.message, self.mark = message, mark
        self.at = now
        self.pending = pending  # connections that have not had it yet


class _Group:
    def __init__(self) -> None:
        self.open: set[SharedGuard] = set()
        self.last: _LastMessage | None = None


class SharedGuard:
    """The guard of one connection of a group."""

    def __init__(self, guard: Guard, group: _Group, *, latching: bool) -> None:
        self._guard, self._group, self._latching = guard, group, latching

    def replace(self, guard: Guard) -> None:
        self._guard = guard

    def check(self, now: float) -> None:
        self._guard.check(now)

    def initial_message(self, now: float) -> list[Buffer]:
        """The last message that passed for the key, if the rate limit allows no newer one."""
        # So connecting to a latching program does not reveal whether a message changed.
        last = self._group.last
        if last is None or not self._latching or self._guard.ready(now):
            return []
        return self._guard.apply(last.message, now, last.mark) or []

    def apply(self, message: bytes, now: float) -> list[Buffer] | None:
        # Equal to one that passed: its copy, once on each connection that was open at that time, and within
        # `WINDOW` seconds, since a constant message would otherwise keep passing.
        last = self._group.last
        is_recent = last is not None and self in last.pending and int(now) - int(last.at) <= WINDOW
        if last is not None and is_recent and message == last.message:
            last.pending.discard(self)
            return self._guard.apply(message, now, last.mark)
        mark = object()
        pieces = self._guard.apply(message, now, mark)
        if pieces is not None:
            self._group.last = _LastMessage(message, mark, now, self._group.open - {self})
        return pieces


class CopyTracker:
    """The state that the connections of each key share; of one identity."""

    def __init__(self) -> None:
        self._groups: WeakKeyDictionary[Memory, _Group] = WeakKeyDictionary()

    @contextmanager
    def share(
        self, guard: Guard | None, now: float, *, latching: bool
    ) -> Iterator[tuple[SharedGuard | ReplaceableGuard | None, list[Buffer]]]:
        """The guard of one connection while the block runs; None: the connection is unrestricted.

        With it the first message for the peer, in pieces; empty: none.
        """
        if guard is None or guard.memory is None:
            yield None if guard is None else ReplaceableGuard(guard), []
            return
        group = self._groups.setdefault(guard.memory, _Group())
        shared_guard = SharedGuard(guard, group, latching=latching)
        group.open.add(shared_guard)
        try:
            yield shared_guard, shared_guard.initial_message(now)
        finally:
            group.open.discard(shared_guard)
            if not (group.open or latching):
                group.last = None  # no connection will need it


@dataclass(eq=False)
class _ProgramMemory(Generic[HolderT]):
    name: str
    holders: set[HolderT] = field(default_factory=set)


class ProgramMemories(Generic[HolderT]):
    """The memories of one identity: one for each program that runs at a time.

    `has_ended`: whether a holder that was not released has ended; no subscriber can influence that.
    """

    def __init__(self, scope: MemoryScope, has_ended: Callable[[HolderT], bool] = lambda _: False) -> None:
        self._scope, self._has_ended = scope, has_ended
        self._memories: list[_ProgramMemory[HolderT]] = []

    def acquire(self, name: str, holder: HolderT) -> MemoryScope:
        """The memory scope of `holder`, a program of this name."""
        # Each program has its own, also if others publish the topic: their values would reset its hysteresis.
        # Not one for each name: `rostopic pub` and `rosbag play` use a new one in each run.
        memories = self._memories
        memory = next((each for each in memories if holder in each.holders), None)
        memory = memory or next((each for each in memories if each.name == name), None)
        if memory is None:  # that of a program that has ended, or a new one
            for each in memories:
                self._drop_ended(each)
            memory = next((each for each in memories if not each.holders), None)
        if memory is None:
            memory = _ProgramMemory("")
            memories.append(memory)
        self._drop_ended(memory)
        if not memory.holders:
            memory.name = name
        memory.holders.add(holder)
        return self._scope.child(str(self._memories.index(memory)))

    def release(self, holder: HolderT) -> None:
        for memory in self._memories:
            memory.holders.discard(holder)

    def _drop_ended(self, memory: _ProgramMemory[HolderT]) -> None:
        memory.holders = {holder for holder in memory.holders if not self._has_ended(holder)}


class Replacing:
    """Replaces the guard of one forwarded connection; None: bytes pass unread."""

    def __init__(
        self, guard: SharedGuard | ReplaceableGuard | None, rebuild: Rebuild, *, to_peer: bool
    ) -> None:
        self._guard, self._rebuild, self._to_peer = guard, rebuild, to_peer

    def rebuild(self, decision: Decision) -> Guard | None:
        """The guard for another decision."""
        renewed = self._rebuild(decision)
        if self._guard is None:
            if renewed is not None:  # bytes that passed unread have no known beginnings of messages
                raise ConnectionHeaderRefused("messages that are restricted now were passed on unread")
            return None
        if renewed is None:
            return Guard(None, decision)  # lets everything pass until it expires
        # With limits no message may wait for its reader: see `pump.send_filtered_nowait`.
        has_limits = renewed.memory is not None
        if has_limits and self._to_peer and not isinstance(self._guard, SharedGuard):
            raise ConnectionHeaderRefused("messages that are limited now had to wait for the peer")
        return renewed

    def swap(self, guard: Guard | None) -> None:
        if self._guard is not None and guard is not None:
            self._guard.replace(guard)
