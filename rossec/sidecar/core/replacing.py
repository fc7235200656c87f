"""How a renewed grant takes its place where a connection is forwarded. Pure.

A program's bytes that pass unread have no known beginnings of messages, and a connection with
limits must not let its messages wait: what would need another way of forwarding is refused here,
and the connection is made anew.
"""

from collections.abc import Callable
from typing import TypeAlias

from grants.decision import Decision
from grants.guard import Guard
from rossec.errors import ConnectionHeaderRefused
from rossec.sidecar.core.copies import ReplaceableGuard, SharedGuard

Rebuild: TypeAlias = Callable[[Decision], Guard | None]


class Replacing:
    """Replaces the guard of one forwarded connection.

    Args:
        guard: the one that messages pass; None: bytes pass unread.
        rebuild: makes the guard for a decision; None: it has no restrictions.
        to_peer: messages go to a peer, whose limits must not wait for it.
    """

    def __init__(
        self, guard: SharedGuard | ReplaceableGuard | None, rebuild: Rebuild, *, to_peer: bool
    ) -> None:
        self._guard = guard
        self._rebuild = rebuild
        self._to_peer = to_peer

    def rebuild(self, decision: Decision) -> Guard | None:
        """The guard for another decision.

        Raises:
            HintedError: it does not fit this connection.
        """
        renewed = self._rebuild(decision)
        if self._guard is None:
            if renewed is not None:
                raise ConnectionHeaderRefused(
                    "messages that are restricted now were passed on unread"
                )
            return None
        if renewed is None:
            return Guard(None, decision)  # lets everything pass until it expires
        has_limits = renewed.memory is not None
        if has_limits and self._to_peer and not isinstance(self._guard, SharedGuard):
            raise ConnectionHeaderRefused("messages that are limited now had to wait for the peer")
        return renewed

    def swap(self, guard: Guard | None) -> None:
        """Put a guard from `rebuild` in the place of the one in force."""
        if self._guard is not None and guard is not None:
            self._guard.replace(guard)
