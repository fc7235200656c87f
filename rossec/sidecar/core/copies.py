"""Copies of one message: a program sends one to each connection, also to those of one key.

Pure. A message that passed once passes on all connections of the key. A message equal to one that
passed counts as its copy: once on each connection that was open at that time, and within `WINDOW`
seconds, since a constant message would otherwise keep passing. A new connection to a latching
program gets the last message that passed for its key, unless the rate limit has room for a new
one. So connecting does not reveal whether a message changed.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, Protocol
from weakref import WeakKeyDictionary

from grants.filters.codegen import Buffer
from grants.guard import Guard
from grants.memory import Memory

WINDOW: Final = 1  # whole seconds


class MessageGuard(Protocol):
    """Filters the messages between a program and a peer: a guard, or one that handles copies."""

    def check(self, now: float) -> None:
        """As of `Guard`."""

    def apply(self, message: bytes, now: float) -> list[Buffer] | None:
        """As of `Guard`."""


class ReplaceableGuard:
    """A guard that another one replaces between two messages; it costs no call more than one."""

    def __init__(self, guard: Guard) -> None:
        self.check = guard.check
        self.apply: Callable[[bytes, float], list[Buffer] | None] = guard.apply

    def replace(self, guard: Guard) -> None:
        """Use `guard` from the next message on."""
        self.check, self.apply = guard.check, guard.apply


class _LastMessage:
    """The last message that passed, and the connections that have not had it yet."""

    def __init__(
        self, message: bytes, mark: object, now: float, pending: set["SharedGuard"]
    ) -> None:
        self.message = message
        self.mark = mark
        self.at = now
        self.pending = pending


class _Group:
    """The connections of one key for one topic of one program."""

    def __init__(self) -> None:
        self.open: set[SharedGuard] = set()
        self.last: _LastMessage | None = None


class SharedGuard:
    """The guard of one connection of a group."""

    def __init__(self, guard: Guard, group: _Group, *, latching: bool) -> None:
        self._guard = guard
        self._group = group
        self._latching = latching

    def replace(self, guard: Guard) -> None:
        """Use `guard`, of the same key or without limits, from the next message on."""
        self._guard = guard

    def check(self, now: float) -> None:
        """As of `Guard`."""
        self._guard.check(now)

    def initial_message(self, now: float) -> list[Buffer]:
        """The last message that passed for the key, if the rate limit allows no newer one."""
        last = self._group.last
        if last is None or not self._latching or self._guard.ready(now):
            return []
        return self._guard.apply(last.message, now, last.mark) or []

    def apply(self, message: bytes, now: float) -> list[Buffer] | None:
        """As of `Guard`."""
        last = self._group.last
        if last is not None and self._is_copy(last, message, now):
            last.pending.discard(self)
            return self._guard.apply(message, now, last.mark)
        mark = object()
        pieces = self._guard.apply(message, now, mark)
        if pieces is not None:
            self._group.last = _LastMessage(message, mark, now, self._group.open - {self})
        return pieces

    def _is_copy(self, last: _LastMessage, message: bytes, now: float) -> bool:
        return (
            self in last.pending and int(now) - int(last.at) <= WINDOW and message == last.message
        )


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
