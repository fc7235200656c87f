"""How many signatures of unknown senders are verified in a second. Pure.

Verifying costs a tenth of a millisecond here and a millisecond on a small robot, so it comes last,
after all cheap checks, and is limited by three token buckets: an address has
its own; all addresses together have one for new chains, and one for chains that verified before; an
address from which an announcement *verified* uses its own bucket alone.
"""

from collections import OrderedDict
from collections.abc import Hashable
from typing import Final

from grants.token_bucket import TokenBucket
from rossec.errors import AnnouncementRefused

SHARE: Final = 50.0  # a second, and at once, for one address
TOTAL: Final = 200.0  # the same for all addresses without a verified announcement
MAX_SOURCES: Final = 1024
MAX_VERIFIED: Final = 64


class Budget:
    """The limits on signature checks for each source."""

    def __init__(self, share: float = SHARE, total: float = TOTAL) -> None:
        self._share = share
        self._shares: OrderedDict[Hashable, TokenBucket] = OrderedDict()
        self._verified: OrderedDict[Hashable, TokenBucket] = OrderedDict()
        self._totals = {known: TokenBucket(total, total) for known in (True, False)}

    def spend(self, source: Hashable, cost: int, clock: float, *, known_chain: bool) -> None:
        """Charge `cost` signatures to `source`.

        Raises:
            AnnouncementRefused: the limit is reached.
        """
        buckets = [self._verified[source]] if source in self._verified else [
            self._of(source), self._totals[known_chain]
        ]  # fmt: skip
        if not all(bucket.refill(clock) >= cost for bucket in buckets):
            raise AnnouncementRefused("more announcements than can be checked")
        for bucket in buckets:
            bucket.tokens -= cost

    def note_verified(self, source: Hashable) -> None:
        """An announcement from `source` verified."""
        if source not in self._verified:
            self._verified[source] = self._of(source)
            _bound(self._verified, MAX_VERIFIED)

    def _of(self, source: Hashable) -> TokenBucket:
        if source not in self._shares:
            self._shares[source] = TokenBucket(self._share, self._share)
            _bound(self._shares, MAX_SOURCES)
        self._shares.move_to_end(source)
        return self._shares[source]


def _bound(table: OrderedDict[Hashable, TokenBucket], most: int) -> None:
    """Drop the least recently used entries."""
    while len(table) > most:
        table.popitem(last=False)
