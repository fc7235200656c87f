"""How many half-open connections this process has, in total and from one source (N8, M11).

A socket counts from `accept` until its peer is authenticated, or until it is closed: one whose
handshake failed lingers, so that its peer can read the refusal, and costs a descriptor as before.
At the limit, the one that lingers longest is closed first; then, if the total is reached, one of
the source that has most, if it has more than the source of the new one. A whole LAN is one source
of IPv6: at its limit, one of the address that has most makes room in the same way.
"""

import functools
import ipaddress
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from threading import Lock
from typing import Any
from weakref import finalize


@dataclass(frozen=True)
class HalfOpen:
    """The caps."""

    per_address: int = 128
    total: int = 512


class HalfOpenSlot:
    """One half-open connection; made by `HalfOpenCount.admit`."""

    __slots__ = ("_count", "address", "close", "source")

    def __init__(self, count: "HalfOpenCount", source: str, address: str) -> None:
        self._count = count
        self.source = source
        self.address = address
        self.close: Callable[[], None] | None = None
        """Closes its socket at once, to make room; None where that cannot be done."""

    def linger(self) -> None:
        """Its handshake has failed, its socket is still open: it is evicted first."""
        self._count.lingers(self)

    def release(self) -> None:
        """Its peer is authenticated, or its socket is closed; once is enough."""
        self._count.forget(self)

    def bind(self, sock: Any) -> None:
        """Release the slot when `sock` is collected, at the latest."""
        finalize(sock, self._count.collected.append, self).atexit = False


class HalfOpenCount:
    """The count against the caps; threads may share it."""

    def __init__(self, caps: HalfOpen) -> None:
        self._caps = caps
        self._total = 0
        # Both in the order of their beginning.
        self._sources: dict[str, dict[HalfOpenSlot, None]] = {}
        self._lingering: dict[HalfOpenSlot, None] = {}
        self._lock = Lock()
        self.collected: deque[HalfOpenSlot] = deque()
        """Slots whose sockets were garbage collected: that may happen with the lock held."""

    def __len__(self) -> int:
        with self._lock:
            self._forget_collected()
            return self._total

    def admit(self, address: str) -> HalfOpenSlot | None:
        """Count one more from this address; None: there is no room."""
        source = source_of(address)
        with self._lock:
            self._forget_collected()
            victim = None
            if self._is_full(source):
                victim = self._victim(source, address)
                if victim is None:
                    return None
                self._remove(victim)
            slot = HalfOpenSlot(self, source, address)
            self._sources.setdefault(source, {})[slot] = None
            self._total += 1
        if victim is not None and victim.close is not None:
            victim.close()
        return slot

    def forget(self, slot: HalfOpenSlot) -> None:
        """As of `HalfOpenSlot.release`."""
        with self._lock:
            self._remove(slot)

    def _forget_collected(self) -> None:
        while self.collected:
            self._remove(self.collected.popleft())

    def lingers(self, slot: HalfOpenSlot) -> None:
        """As of `HalfOpenSlot.linger`."""
        with self._lock:
            if slot in self._sources.get(slot.source, ()):
                self._lingering[slot] = None

    def _is_full(self, source: str) -> bool:
        held = len(self._sources.get(source, ()))
        return self._total >= self._caps.total or held >= self._caps.per_address

    def _victim(self, source: str, address: str) -> HalfOpenSlot | None:
        """The slot to evict for a caller at `address`, which is of `source`."""
        own = self._sources.get(source, {})
        own_full = len(own) >= self._caps.per_address
        for slot in self._lingering:
            if slot.close is not None and (slot.source == source or not own_full):
                return slot
        if own_full:
            return _of_most(own, address)
        most = max(self._sources.values(), key=len, default={})
        if len(most) <= len(own) + 1:
            return None
        return next((slot for slot in most if slot.close is not None), None)

    def _remove(self, slot: HalfOpenSlot) -> None:
        slots = self._sources.get(slot.source, {})
        if slot not in slots:
            return
        self._total -= 1
        self._lingering.pop(slot, None)
        del slots[slot]
        if not slots:
            del self._sources[slot.source]


def _of_most(slots: Iterable[HalfOpenSlot], address: str) -> HalfOpenSlot | None:
    """The oldest slot of the address that has most, if it has more than `address` would have."""
    counts = Counter(slot.address for slot in slots)
    most = max(counts, key=counts.__getitem__)
    if counts[most] <= counts[address] + 1:
        return None
    return next((slot for slot in slots if slot.address == most and slot.close is not None), None)


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
