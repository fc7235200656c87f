"""How many signatures of strangers are checked in a second. Pure.

A check costs a tenth of a millisecond here and a millisecond on a small robot, so it is charged
last, when everything that is cheap has been asked, and in three purses, so that none empties
another's: an address has a share of its own; all addresses together have one for chains that were
never seen, and one for chains that verified before; an address from which an announcement
*verified* draws on its share alone.
"""

from collections import OrderedDict
from collections.abc import Hashable
from typing import Final

from rossec.errors import AnnouncementRefused

SHARE: Final = 50.0  # a second, and at once, for one address
TOTAL: Final = 200.0  # the same for all addresses that have proved nothing
MAX_SOURCES: Final = 1024
MAX_PROVEN: Final = 64


class AttemptBucket:
    """A token bucket that is full at first; `rate` a second, and no more than that at once."""

    def __init__(self, rate: float) -> None:
        self._rate = self._left = rate
        self._at = 0.0

    def has(self, cost: int, clock: float) -> bool:
        """Whether `cost` can be taken now."""
        earned = max(0.0, clock - self._at) * self._rate
        self._left, self._at = min(self._rate, self._left + earned), clock
        return self._left >= cost

    def take(self, cost: int) -> None:
        """Take `cost`, which there is."""
        self._left -= cost


class Budget:
    """What the checks of each source may cost."""

    def __init__(self, share: float = SHARE, total: float = TOTAL) -> None:
        self._share = share
        self._shares: OrderedDict[Hashable, AttemptBucket] = OrderedDict()
        self._proven: OrderedDict[Hashable, AttemptBucket] = OrderedDict()
        self._totals = {True: AttemptBucket(total), False: AttemptBucket(total)}

    def spend(self, source: Hashable, cost: int, clock: float, *, known_chain: bool) -> None:
        """Charge `cost` signatures to `source`.

        Raises:
            AnnouncementRefused: there is nothing left for it now.
        """
        buckets = [self._proven[source]] if source in self._proven else [
            self._of(source), self._totals[known_chain]
        ]  # fmt: skip
        if not all(bucket.has(cost, clock) for bucket in buckets):
            raise AnnouncementRefused("more announcements than can be checked")
        for bucket in buckets:
            bucket.take(cost)

    def note_verified(self, source: Hashable) -> None:
        """An announcement from `source` verified."""
        if source not in self._proven:
            self._proven[source] = self._of(source)
            _bound(self._proven, MAX_PROVEN)

    def _of(self, source: Hashable) -> AttemptBucket:
        if source not in self._shares:
            self._shares[source] = AttemptBucket(self._share)
            _bound(self._shares, MAX_SOURCES)
        self._shares.move_to_end(source)
        return self._shares[source]


def _bound(table: OrderedDict[Hashable, AttemptBucket], most: int) -> None:
    """The one that was used longest ago makes room: it begins anew, within the total."""
    while len(table) > most:
        table.popitem(last=False)
