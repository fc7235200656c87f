"""How many handshakes may be unfinished at a time, in all and from one source (attacks N8, M11)."""

import functools
import ipaddress
from collections import Counter
from dataclasses import dataclass
from threading import Lock


@dataclass(frozen=True)
class HalfOpen:
    """The caps."""

    per_address: int = 128
    total: int = 512


class HalfOpenCount:
    """The count against the caps; threads may share it."""

    def __init__(self, caps: HalfOpen) -> None:
        self._caps = caps
        self._total = 0
        self._sources: Counter[str] = Counter()
        self._lock = Lock()

    def admit(self, address: str) -> bool:
        """Count one more from this address, or refuse it."""
        source = source_of(address)
        with self._lock:
            if self._total >= self._caps.total or self._sources[source] >= self._caps.per_address:
                return False
            self._total += 1
            self._sources[source] += 1
            return True

    def settle(self, address: str) -> None:
        """A handshake from this address is over, one way or the other."""
        source = source_of(address)
        with self._lock:
            self._total -= 1
            self._sources[source] -= 1
            if self._sources[source] <= 0:
                del self._sources[source]


@functools.lru_cache(maxsize=256)
def source_of(address: str) -> str:
    """What counts as one source: an IPv4 address, or the /64 of an IPv6 address."""
    try:
        parsed = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(parsed, ipaddress.IPv4Address):
        return str(parsed)
    if parsed.ipv4_mapped is not None:
        return str(parsed.ipv4_mapped)
    return str(ipaddress.ip_network((parsed, 64), strict=False))
