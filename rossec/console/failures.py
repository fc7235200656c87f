"""How often somebody may be wrong: five times a minute, then a minute's pause. Pure.

Codes have 128 bits and passkeys cannot be guessed: this keeps noise from the authority, and makes
whoever mistypes look again. Counted by address, so that one device does not lock out another; of
IPv6 by the network, since a device has as many addresses as it likes.
"""

import ipaddress
from collections import OrderedDict, deque
from typing import Final

MAX_FAILURES: Final = 5
WINDOW: Final = 60  # seconds
MAX_ADDRESSES: Final = 256
_NETWORK: Final = 64  # bits of an IPv6 address that name the network


class FailureLimit:
    """The failures of the last minute, by address."""

    def __init__(self) -> None:
        self._failures: OrderedDict[str, deque[int]] = OrderedDict()

    def is_blocked(self, address: str, now: int) -> bool:
        """Whether this address has to wait."""
        if not address:  # behind a proxy all have none: one would keep out everybody
            return False
        times = self._failures.get(_key(address))
        return times is not None and len(_recent(times, now)) >= MAX_FAILURES

    def note(self, address: str, now: int) -> None:
        """Note that this address was wrong."""
        key = _key(address)
        times = self._failures.setdefault(key, deque(maxlen=MAX_FAILURES))
        self._failures.move_to_end(key)
        times.append(now)
        while len(self._failures) > MAX_ADDRESSES:
            self._failures.popitem(last=False)


def _recent(times: deque[int], now: int) -> list[int]:
    return [time for time in times if abs(now - time) < WINDOW]


def _key(address: str) -> str:
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if found.version == 6 and found.ipv4_mapped is None:
        return str(ipaddress.ip_network((found, _NETWORK), strict=False))
    return str(getattr(found, "ipv4_mapped", None) or found)
