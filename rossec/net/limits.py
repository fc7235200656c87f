"""How much a peer may have one connection hold, by what it is for; how many may be half open (N8, M11).

A unit is assembled before it is delivered. So a peer that is authenticated but not yet authorized may send no
more than a connection header needs; a subscriber never more, and an authorized peer as much as its messages
can need. How long it may take: `Progress`.
"""

import functools
import ipaddress
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock
from typing import Any, Final
from weakref import finalize

from rossec.channel.opening import WireProtocol
from rossec.channel.records import ChannelLimits
from rossec.ros.http import HEADERS_LIMIT
from rossec.ros.tcpros import HEADER_LIMIT, MESSAGE_LIMIT
from rossec.ros.xmlrpc import BODY_LIMIT

PREAUTH_LIMIT: Final = 2 * HEADER_LIMIT  # with what was sent in the same burst
BATCH_LIMIT: Final = 2 * 1024 * 1024  # 256 KiB of messages, one more, and 4 bytes for each
UNSHOWN_BODY: Final = 64 * 1024
"""Bytes of a call that are parsed of a caller that has shown no grant (but those that show one)."""
UNSHOWN_UNIT: Final = 1024 * 1024 + HEADERS_LIMIT
"""Bytes of a call that arrive from such a caller: what is longer than it may be is answered so."""
_CALL: Final = BODY_LIMIT + HEADERS_LIMIT
_CALLS: Final = ChannelLimits(unit=_CALL, preauth_limit=UNSHOWN_UNIT)
_MESSAGES: Final = MESSAGE_LIMIT + BATCH_LIMIT  # in any form of a node

ACCEPTED: Final = {
    WireProtocol.HTTP: _CALLS,
    WireProtocol.TCPROS: ChannelLimits(unit=_MESSAGES, preauth_limit=PREAUTH_LIMIT),
}
"""Of accepted connections; raised once the peer is authorized: a service client, a caller that has
shown a grant, the master."""

DIALLED: Final = {
    WireProtocol.HTTP: ChannelLimits(unit=_CALL),
    WireProtocol.TCPROS: ChannelLimits(unit=_MESSAGES),
}
"""Of connections to addresses from the master; messages may follow the header at once."""


def message_limit(size: int | None, most: int) -> int:
    """How long a message may be, if any may have `most`; `size`: of every one of the type, if it is fixed."""
    return most if size is None else min(max(size, HEADER_LIMIT), most)


def unit_limit(size: int | None, most: int) -> int:
    """How long a unit with such messages may be: senders batch short messages."""
    return message_limit(size, most) + BATCH_LIMIT


@dataclass(frozen=True)
class HalfOpenLimits:
    per_address: int = 128
    total: int = 512


@dataclass(eq=False, slots=True)
class HalfOpenSlot:
    """One half-open connection; made by `HalfOpenCount.admit`."""

    _count: "HalfOpenCount"
    source: str
    address: str
    close: Callable[[], None] | None = None  # closes its socket at once, where that can be done

    def linger(self) -> None:
        self._count.lingers(self)

    def release(self) -> None:
        self._count.forget(self)

    def bind(self, sock: Any) -> None:
        finalize(sock, self._count.collected.append, self).atexit = False


class HalfOpenCount:
    """The half-open connections of this process, in total and from one source; threads may share it.

    A socket counts from `accept` until its peer is authenticated, or until it is closed: one whose handshake
    failed lingers, so that its peer can read the refusal, and costs a descriptor as before. At the limit, the
    one that lingers longest is closed first; then, if the total is reached, one of the source that has most,
    if it has more than the source of the new one. A whole LAN is one source of IPv6: at its limit, one of the
    address that has most makes room in the same way.
    """

    def __init__(self, caps: HalfOpenLimits) -> None:
        self._caps = caps
        self._total = 0
        # Both in the order of their beginning.
        self._sources: dict[str, dict[HalfOpenSlot, None]] = {}
        self._lingering: dict[HalfOpenSlot, None] = {}
        self._lock = Lock()
        # Slots whose sockets were garbage collected: that may happen with the lock held.
        self.collected: deque[HalfOpenSlot] = deque()

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
            held = len(self._sources.get(source, ()))
            if self._total >= self._caps.total or held >= self._caps.per_address:
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
        with self._lock:
            self._remove(slot)

    def _forget_collected(self) -> None:
        while self.collected:
            self._remove(self.collected.popleft())

    def lingers(self, slot: HalfOpenSlot) -> None:
        with self._lock:
            if slot in self._sources.get(slot.source, ()):
                self._lingering[slot] = None

    def _victim(self, source: str, address: str) -> HalfOpenSlot | None:
        own = self._sources.get(source, {})
        own_full = len(own) >= self._caps.per_address
        for slot in self._lingering:
            if slot.close is not None and (slot.source == source or not own_full):
                return slot
        if own_full:  # the oldest slot of the address that has most, if it has more than `address` would have
            counts = Counter(slot.address for slot in own)
            busiest = max(counts, key=counts.__getitem__)
            # A share like everybody's ends nobody else's (0049).
            if counts[busiest] <= counts[address] + 1:
                return None
            return next((slot for slot in own if slot.address == busiest and slot.close is not None), None)
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
