"""The watch over a node's live connections: cut what has expired, been revoked or gone stale.

A shell around `links.termination_reason`. It waits for nothing but the clock: a master that hangs
must not keep an expired link alive.
"""

import asyncio
import logging
from collections.abc import Callable, Iterable
from typing import Final, Protocol
from weakref import WeakSet

from ca.revocation.state import Revocations
from rossec import clock
from rossec.participant.connections import AuthorizedConnection, termination_reason

PERIOD: Final = 1.0  # seconds between looks; an expiry is met to the second

WENT_BACK: Final = (
    "the host's clock went back: nobody new is let in until the master confirms its list again"
)

_log = logging.getLogger("rossec.node")


class NodePorts(Protocol):
    """The ports of a node."""

    def abort_revoked(self, revoked: frozenset[bytes]) -> None:
        """Close every connection of a revoked key, for whatever purpose it was accepted."""


class ConnectionWatchdog:
    """Cuts the links of one node."""

    def __init__(
        self,
        revocations: Revocations,
        links: Callable[[], Iterable[AuthorizedConnection]],
        listener: NodePorts,
    ) -> None:
        self._revocations = revocations
        self._links = links
        self._listener = listener
        self._setbacks = clock.Setbacks()
        self._done: WeakSet[AuthorizedConnection] = (
            WeakSet()
        )  # cut, and not yet taken off by who serves them

    async def run(self) -> None:
        """Look again and again, until cancelled."""
        while True:
            now = clock.time()
            soonest = min((link.ends for link in self._live()), default=now + PERIOD)
            await asyncio.sleep(max(0.0, min(PERIOD, soonest - now)))
            self.look(clock.now())

    def look(self, now: int) -> None:
        """Cut what must end; after a clock that went back, wait for news of revocations."""
        if self._setbacks.any_new():
            _log.warning(WENT_BACK)
            self._revocations.doubt(now - 1)
        self.cut(now)

    def cut(self, now: int) -> None:
        """Cut every link that must end at `now`, and every connection of a revoked key."""
        for link in self._live():
            reason = termination_reason(link, self._revocations, now)
            if reason is not None:
                self._done.add(link)
                _log.warning("cut %s: %s", link.stream.peer.name, reason)
                link.stream.abort(reason)
        self._listener.abort_revoked(self._revocations.entries)

    def _live(self) -> list[AuthorizedConnection]:
        return [link for link in self._links() if link not in self._done]
