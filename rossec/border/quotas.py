"""How much one thing, and whoever is not authenticated yet, may ask of a border router. Pure."""

from collections import OrderedDict
from collections.abc import Hashable
from ipaddress import IPv6Address, ip_address
from typing import Final

from grants.token_bucket import TokenBucket

MESSAGE_RATE: Final = 10.0  # a second, of one thing
MESSAGE_BURST: Final = 20.0
MAX_OBSERVATIONS: Final = 64  # of one thing
MAX_RESOURCES: Final = 96  # of one thing, of all kinds
MAX_BLOCK: Final = 1024  # octets in one message
MAX_BODY: Final = 16 * 1024  # octets, block by block
SOURCE_RATE: Final = 10.0  # handshakes a second, of one address and port
SOURCE_BURST: Final = 10.0
MAX_SOURCES: Final = 4096


class Quota:
    """Messages of one thing: `take` says whether one more is within its rate.

    A thing that goes on is told so a few times; then what it sends is not even decrypted.
    """

    __slots__ = ("_beyond", "_bucket", "dropped")

    def __init__(self, rate: float = MESSAGE_RATE, burst: float = MESSAGE_BURST) -> None:
        self._bucket = TokenBucket(rate, burst)
        self._beyond = TokenBucket(rate, burst)
        self.dropped = 0

    def take(self, now: float) -> bool:
        """Whether it is within the rate; if not, it counts as dropped."""
        if self._bucket.refill(now) < 1:
            self.dropped += 1
            self._beyond.tokens -= min(1.0, self._beyond.refill(now))
            return False
        self._bucket.tokens -= 1
        return True

    def is_spent(self, now: float) -> bool:
        """Whether nothing of this thing is looked at now; then it counts as dropped."""
        spent = self._bucket.refill(now) < 1 and self._beyond.refill(now) < 1
        self.dropped += spent
        return spent


class Unauthenticated:
    """What senders may cost before they are authenticated: each of them, and all together.

    One port, one host (of IPv6 its network of 64 bits), all: who has many ports or addresses still
    leaves half to others. The most recent ones are remembered. A sender that forges addresses uses
    up what all have together; things that are authenticated already do not need it.

    Args:
        total: how many a second of all senders.
    """

    def __init__(self, total: float) -> None:
        self._total = total
        self._all = TokenBucket(total, total)
        self._sources: OrderedDict[Hashable, TokenBucket] = OrderedDict()

    def take(self, host: str, port: int, now: float) -> bool:
        """Whether an attempt of this sender is looked at."""
        half = self._total / 2
        buckets = (
            self._bucket((host, port), SOURCE_RATE, SOURCE_BURST),
            self._bucket(network_of(host), half, half),
            self._all,
        )
        while len(self._sources) > MAX_SOURCES:
            self._sources.popitem(last=False)
        if any(bucket.refill(now) < 1 for bucket in buckets):
            return False
        for bucket in buckets:
            bucket.tokens -= 1
        return True

    def _bucket(self, source: Hashable, rate: float, burst: float) -> TokenBucket:
        bucket = self._sources.pop(source, None) or TokenBucket(rate, burst)
        self._sources[source] = bucket
        return bucket


def network_of(host: str) -> bytes:
    """The octets that one host cannot change: an IPv4 address, or the first 64 bits of IPv6."""
    address = ip_address(host.partition("%")[0])
    mapped = address.ipv4_mapped if isinstance(address, IPv6Address) else address
    return address.packed[:8] if mapped is None else mapped.packed
