"""Copies of one message: a program sends one to each connection, also where the key is the same.

Pure. To be let through once is to be let through on all connections of the key. What arrives beside
a message that was let through, and equals it, is taken for its copy: once on each connection that
was open then, and within `WINDOW` seconds, since a constant message would otherwise go on passing.
A latching program's newcomer is shown what its key was last let see, unless the rate has room for
what comes now. So whether a message changed cannot be found out by connecting.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, Protocol
from weakref import WeakKeyDictionary

from grants.filters.codegen import Buffer
from grants.guard import Guard
from grants.memory import Memory

WINDOW: Final = 1  # seconds by a clock of whole seconds


class MessageGuard(Protocol):
    """What stands between a program and a peer: a guard, or one that knows of copies."""

    def check(self, now: int) -> None:
        """As of `Guard`."""

    def apply(self, message: bytes, now: int) -> list[Buffer] | None:
        """As of `Guard`."""


class _LastMessage:
    """The message that was let through last, and which connections still lack it."""

    def __init__(self, message: bytes, mark: object, now: int, pending: set["SharedGuard"]) -> None:
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
    """One of them."""

    def __init__(self, guard: Guard, group: _Group, *, latching: bool) -> None:
        self._guard = guard
        self._group = group
        self._latching = latching

    def check(self, now: int) -> None:
        """As of `Guard`."""
        self._guard.check(now)

    def initial_message(self, now: int) -> list[Buffer]:
        """What the key was let see, where the rate allows nothing newer."""
        last = self._group.last
        if last is None or not self._latching or self._guard.ready(now):
            return []
        return self._guard.apply(last.message, now, last.mark) or []

    def apply(self, message: bytes, now: int) -> list[Buffer] | None:
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

    def _is_copy(self, last: _LastMessage, message: bytes, now: int) -> bool:
        return self in last.pending and now - last.at <= WINDOW and message == last.message


class CopyTracker:
    """What the connections of each key have in common; of one identity."""

    def __init__(self) -> None:
        self._groups: WeakKeyDictionary[Memory, _Group] = WeakKeyDictionary()

    @contextmanager
    def share(
        self, guard: Guard | None, now: int, *, latching: bool
    ) -> Iterator[tuple[MessageGuard | None, list[Buffer]]]:
        """What judges the messages of one connection while the block runs (None: nothing does).

        With it what the peer is shown first, in pieces, if there is something.
        """
        if guard is None or guard.memory is None:
            yield guard, []
            return
        group = self._groups.setdefault(guard.memory, _Group())
        shared_guard = SharedGuard(guard, group, latching=latching)
        group.open.add(shared_guard)
        try:
            yield shared_guard, shared_guard.initial_message(now)
        finally:
            group.open.discard(shared_guard)
            if not (group.open or latching):
                group.last = None  # nobody will be shown it
