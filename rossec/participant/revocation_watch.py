"""Cuts connections that have expired, were revoked, or whose revocation data is stale.

It waits for the clock only: a master that hangs must not keep an expired connection open.
"""

import asyncio
import logging
from collections.abc import Callable
from typing import Any, Final

from rossec import clock
from rossec.participant.connections import ConnectionTable

PERIOD: Final = 1.0  # seconds between checks; an expiry is exact to the second

_log = logging.getLogger("rossec.node")


class ConnectionWatchdog:
    """Checks the connections of one identity.

    Args:
        expire_confirmation: expires the confirmation of the revocation list at that time.
    """

    def __init__(
        self, connections: ConnectionTable[Any], expire_confirmation: Callable[[int], None]
    ) -> None:
        self._connections = connections
        self._expire_confirmation = expire_confirmation
        self._setbacks = clock.Setbacks()

    async def run(self) -> None:
        """Check periodically until cancelled."""
        while True:
            expiry = self._connections.next_expiry
            left = PERIOD if expiry is None else expiry - clock.time()
            await asyncio.sleep(max(0.0, min(PERIOD, left)))
            self.check(clock.now())

    def check(self, now: int) -> None:
        """Cut what must end; after the clock was set back, wait for fresh revocation data."""
        if self._setbacks.any_new():
            _log.warning(
                "the host's clock went back: new connections are refused"
                " until the master confirms its revocation list again"
            )
            self._expire_confirmation(now - 1)
        self._connections.cut_ended(now)
