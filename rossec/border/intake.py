"""Datagrams of strangers until it is their turn. Pure.

What comes from where an authenticated thing was last is taken at once, in front of everything here,
up to several times the rate of a thing; more is lost, as the address may be forged. The rest
waits: hosts take turns (of IPv6 networks of 64 bits), and of one host its ports, so that who sends
much delays itself. Bounded in all and for each; what does not fit is lost, as any datagram may be.
"""

from collections import OrderedDict, deque
from functools import lru_cache
from typing import Final

from grants.token_bucket import TokenBucket
from rossec.border.conversations import CAPACITY
from rossec.border.quotas import network_of
from rossec.border.transmissions import Address

RATE: Final = 50.0  # datagrams a second of one thing that are taken at once
BURST: Final = 100.0
OF_PORT: Final = 4  # datagrams of one port that wait
OF_HOST: Final = 64
OF_ALL: Final = 1024

_network_of = lru_cache(4096)(network_of)


class _Host:
    """What waits of one host, by its ports."""

    def __init__(self) -> None:
        self._ports: OrderedDict[Address, deque[bytes]] = OrderedDict()
        self._count = 0

    def put(self, data: bytes, address: Address) -> bool:
        """Whether there is room for it."""
        queue = self._ports.get(address)
        if self._count >= OF_HOST or (queue is not None and len(queue) >= OF_PORT):
            return False
        if queue is None:
            queue = self._ports[address] = deque()
        queue.append(data)
        self._count += 1
        return True

    def take(self) -> tuple[bytes, Address]:
        """The oldest of the port whose turn it is."""
        address, queue = self._ports.popitem(last=False)
        data = queue.popleft()
        self._count -= 1
        if queue:
            self._ports[address] = queue
        return data, address

    def __bool__(self) -> bool:
        return self._count > 0


class Intake:
    """Waiting datagrams."""

    def __init__(self) -> None:
        self._waiting: OrderedDict[bytes, _Host] = OrderedDict()
        self._things: OrderedDict[Address, TokenBucket] = OrderedDict()
        self._count = 0
        self.lost = 0

    def __len__(self) -> int:
        return self._count

    def is_first(self, address: Address, now: float) -> bool:
        """Whether the next datagram from where a thing was last is taken at all: at once."""
        bucket = self._things.pop(address, None) or TokenBucket(RATE, BURST)
        self._things[address] = bucket
        if len(self._things) > CAPACITY:
            self._things.popitem(last=False)
        if bucket.refill(now) < 1:
            self.lost += 1
            return False
        bucket.tokens -= 1
        return True

    def put(self, data: bytes, address: Address) -> None:
        """Let a datagram wait, or lose it."""
        network = _network_of(str(address[0]))
        host = self._waiting.get(network) or _Host()
        if self._count >= OF_ALL or not host.put(data, address):
            self.lost += 1
            return
        self._waiting[network] = host
        self._count += 1

    def take(self) -> tuple[bytes, Address] | None:
        """The next datagram, of the host whose turn it is."""
        if not self._waiting:
            return None
        network, host = self._waiting.popitem(last=False)
        taken = host.take()
        if host:
            self._waiting[network] = host
        self._count -= 1
        return taken
