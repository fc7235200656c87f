"""Closes live connections that have expired, were revoked, or whose revocation data is stale.

It waits for the clock only: a master that hangs must not keep an expired connection open.
"""

import asyncio
import logging
from collections.abc import Callable, Iterable
from typing import Final
from weakref import WeakSet

from ca.revocation.state import Revocations
from rossec import clock
from rossec.participant.connections import (
    AcceptedConnections,
    AuthorizedConnection,
    termination_reason,
)

PERIOD: Final = 1.0  # seconds between checks; an expiry is exact to the second

CLOCK_SET_BACK: Final = (
    "the host's clock went back: new connections are refused"
    " until the master confirms its revocation list again"
)

_log = logging.getLogger("rossec.node")


class ConnectionWatchdog:
    """Closes the connections of one node."""

    def __init__(
        self,
        revocations: Revocations,
        connections: Callable[[], Iterable[AuthorizedConnection]],
        accepted: AcceptedConnections,
    ) -> None:
        self._revocations = revocations
        self._connections = connections
        self._accepted = accepted
        self._setbacks = clock.Setbacks()
        # aborted, and not yet removed by the task that serves them
        self._terminated: WeakSet[AuthorizedConnection] = WeakSet()

    async def run(self) -> None:
        """Check periodically until cancelled."""
        while True:
            now = clock.time()
            soonest = min((connection.ends for connection in self._live()), default=now + PERIOD)
            await asyncio.sleep(max(0.0, min(PERIOD, soonest - now)))
            self.check(clock.now())

    def check(self, now: int) -> None:
        """Close what must end; after the clock was set back, wait for fresh revocation data."""
        if self._setbacks.any_new():
            _log.warning(CLOCK_SET_BACK)
            self._revocations.expire_confirmation(now - 1)
        self.close_terminated(now)

    def close_terminated(self, now: int) -> None:
        """Close every connection that must end at `now`, and every one of a revoked key."""
        for connection in self._live():
            reason = termination_reason(connection, self._revocations, now)
            if reason is not None:
                self._terminated.add(connection)
                _log.warning("cut %s: %s", connection.stream.peer.name, reason)
                connection.stream.abort(reason)
        self._accepted.abort_revoked(self._revocations.entries)

    def _live(self) -> list[AuthorizedConnection]:
        return [
            connection for connection in self._connections() if connection not in self._terminated
        ]
