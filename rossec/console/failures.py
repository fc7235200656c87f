"""How often somebody may be wrong: five times a minute, then a minute's pause. Pure.

Codes have 128 bits and passkeys cannot be guessed: this keeps noise from the authority, and makes
whoever mistypes look again. Counted by address, so that one device does not lock out another; of
IPv6 by the network, since a device has as many addresses as it likes. Time is that of a clock that
cannot be set.
"""

from collections import OrderedDict, deque
from typing import Final

from rossec.net.halfopen import source_of

MAX_FAILURES: Final = 5
WINDOW: Final = 60  # seconds
MAX_ADDRESSES: Final = 256


class FailureLimit:
    """The failures of the last minute, by address."""

    def __init__(self) -> None:
        self._failures: OrderedDict[str, deque[float]] = OrderedDict()

    def is_blocked(self, address: str, now: float) -> bool:
        """Whether this address has to wait."""
        if not address:  # behind a proxy all have none: one would keep out everybody
            return False
        times = self._failures.get(source_of(address))
        return times is not None and len(_recent(times, now)) >= MAX_FAILURES

    def note(self, address: str, now: float) -> None:
        """Note that this address was wrong."""
        key = source_of(address)
        times = self._failures.setdefault(key, deque(maxlen=MAX_FAILURES))
        self._failures.move_to_end(key)
        times.append(now)
        while len(self._failures) > MAX_ADDRESSES:
            self._failures.popitem(last=False)


def _recent(times: deque[float], now: float) -> list[float]:
    return [time for time in times if now - time < WINDOW]
