"""What a border router knows of each thing that is authenticated now, and who may ask how much. Pure.

A thing has one conversation. A new one ends the former, as a thing that was restarted has forgotten
it. At most `CAPACITY` are held, and the one that was quiet for longest makes room; whoever is not
authenticated has none.
"""

from collections import OrderedDict, deque
from collections.abc import Callable, Hashable
from functools import lru_cache
from ipaddress import IPv6Address, ip_address
from typing import Final

from ca.bounded import Newest
from grants.limits import TokenBucket
from rossec.border.messages import Address, OscoreContext

MESSAGE_RATE: Final = 10.0  # a second, of one thing
MESSAGE_BURST: Final = 20.0
MAX_OBSERVATIONS: Final = 64  # of one thing
MAX_RESOURCES: Final = 96  # of one thing, of all kinds
MAX_BLOCK: Final = 1024  # octets in one message
MAX_BODY: Final = 16 * 1024  # octets, block by block
SOURCE_RATE: Final = 10.0  # handshakes a second, of one address and port
SOURCE_BURST: Final = 10.0
MAX_SOURCES: Final = 4096
CAPACITY: Final = 1024
REMEMBERED: Final = 4  # answers to the last requests of a thing, in case they are repeated
RATE: Final = 50.0  # datagrams a second of one thing that are taken at once
BURST: Final = 100.0
OF_PORT: Final = 4  # datagrams of one port that wait
OF_HOST: Final = 64
OF_ALL: Final = 1024


class Quota:
    """Messages of one thing: `take` says whether one more is within its rate."""

    __slots__ = ("_beyond", "_bucket", "dropped")

    def __init__(self, rate: float = MESSAGE_RATE, burst: float = MESSAGE_BURST) -> None:
        self._bucket = TokenBucket(rate, burst)
        self._beyond = TokenBucket(rate, burst)
        self.dropped = 0

    def take(self, now: float) -> bool:
        if self._bucket.refill(now) < 1:
            self.dropped += 1
            self._beyond.tokens -= min(1.0, self._beyond.refill(now))
            return False
        self._bucket.tokens -= 1
        return True

    def is_spent(self, now: float) -> bool:
        # A thing that goes on is told so a few times; then what it sends is not even decrypted.
        spent = self._bucket.refill(now) < 1 and self._beyond.refill(now) < 1
        self.dropped += spent
        return spent


class Unauthenticated:
    """What senders may cost before they are authenticated: each of them, and all together.

    A sender that forges addresses uses up what all have together; things that are authenticated
    already do not need it.
    """

    def __init__(self, total: float) -> None:
        self._total = total
        self._all = TokenBucket(total, total)
        self._sources: Newest[Hashable, TokenBucket] = Newest(MAX_SOURCES)

    def take(self, host: str, port: int, now: float) -> bool:
        # One port, one host (of IPv6 its network of 64 bits), all: who has many leaves half to others.
        half = self._total / 2
        buckets = (
            self._bucket((host, port), SOURCE_RATE, SOURCE_BURST),
            self._bucket(network_of(host), half, half),
            self._all,
        )
        if any(bucket.refill(now) < 1 for bucket in buckets):
            return False
        for bucket in buckets:
            bucket.tokens -= 1
        return True

    def _bucket(self, source: Hashable, rate: float, burst: float) -> TokenBucket:
        bucket = self._sources[source] = self._sources.get(source) or TokenBucket(rate, burst)
        return bucket


def network_of(host: str) -> bytes:
    """The octets that one host cannot change: an IPv4 address, or the first 64 bits of IPv6."""
    address = ip_address(host.partition("%")[0])
    mapped = address.ipv4_mapped if isinstance(address, IPv6Address) else address
    return address.packed[:8] if mapped is None else mapped.packed


class Conversation:
    """One thing: its context, where it is, what it may send."""

    __slots__ = ("_answers", "_mid", "address", "context", "name", "quota", "seen", "tokens")

    def __init__(self, name: str, context: OscoreContext, address: Address, mid: int = 0) -> None:
        # The message ID before the first; random, or whoever sees no datagram of this thing could still end
        # its requests by forged resets (RFC 7252 section 11.4).
        self._mid = mid
        self.name: Final = name
        self.context: Final = context
        self.address = address
        self.quota: Final = Quota()
        self.tokens: set[bytes] = set()  # of requests without an answer yet, and of observations
        self.seen = 0.0
        self._answers: deque[tuple[Address, int, bytes]] | None = None

    @property
    def kid(self) -> bytes:
        kid: bytes = self.context.recipient_id
        return kid

    def new_mid(self) -> int:
        # A message ID that this thing was not sent for long (RFC 7252 section 4.4).
        self._mid = (self._mid + 1) & 0xFFFF
        return self._mid

    def remember(self, address: Address, mid: int, answer: bytes) -> None:
        # A request that is repeated is not carried out again.
        if self._answers is None:
            self._answers = deque(maxlen=REMEMBERED)
        self._answers.append((address, mid, answer))

    def remembered(self, address: Address, mid: int) -> bytes | None:
        for source, number, answer in self._answers or ():
            if source == address and number == mid:
                return answer
        return None


class Conversations:
    def __init__(self, ended: Callable[[Conversation], None]) -> None:
        self._ended = ended
        self._by_name: OrderedDict[str, Conversation] = OrderedDict()
        self._by_kid: dict[bytes, Conversation] = {}
        self._by_address: dict[Address, Conversation] = {}

    def __len__(self) -> int:
        return len(self._by_name)

    def all(self) -> list[Conversation]:
        return list(self._by_name.values())

    def find(self, kid: bytes) -> Conversation | None:
        return self._by_kid.get(kid)

    def of(self, name: str) -> Conversation | None:
        return self._by_name.get(name)

    def at(self, address: Address) -> Conversation | None:
        return self._by_address.get(address)

    def add(self, conversation: Conversation) -> None:
        self.drop(conversation.name)
        if (former := self._by_kid.get(conversation.kid)) is not None:
            self.drop(former.name)
        if len(self._by_name) >= CAPACITY:
            self.drop(next(iter(self._by_name)))
        self._by_name[conversation.name] = conversation
        self._by_kid[conversation.kid] = conversation
        self._by_address[conversation.address] = conversation

    def used(self, conversation: Conversation, address: Address) -> None:
        self._by_name.move_to_end(conversation.name)
        if conversation.address != address:
            self._leave(conversation)
            conversation.address = address
            self._by_address[address] = conversation

    def _leave(self, conversation: Conversation) -> None:
        if self._by_address.get(conversation.address) is conversation:
            del self._by_address[conversation.address]

    def drop(self, name: str) -> None:
        found = self._by_name.pop(name, None)
        if found is not None:
            del self._by_kid[found.kid]
            self._leave(found)
            self._ended(found)


_network_of = lru_cache(4096)(network_of)


class _Host:
    def __init__(self) -> None:
        self._ports: OrderedDict[Address, deque[bytes]] = OrderedDict()
        self._count = 0

    def put(self, data: bytes, address: Address) -> bool:
        queue = self._ports.get(address)
        if self._count >= OF_HOST or (queue is not None and len(queue) >= OF_PORT):
            return False
        if queue is None:
            queue = self._ports[address] = deque()
        queue.append(data)
        self._count += 1
        return True

    def take(self) -> tuple[bytes, Address]:
        address, queue = self._ports.popitem(last=False)
        data = queue.popleft()
        self._count -= 1
        if queue:
            self._ports[address] = queue
        return data, address

    def __bool__(self) -> bool:
        return self._count > 0


class DatagramQueue:
    """Datagrams of strangers until it is their turn; bounded in all and for each."""

    def __init__(self) -> None:
        self._waiting: OrderedDict[bytes, _Host] = OrderedDict()
        self._things: Newest[Address, TokenBucket] = Newest(CAPACITY)
        self._count = 0
        self.lost = 0

    def __len__(self) -> int:
        return self._count

    def is_first(self, address: Address, now: float) -> bool:
        # From where an authenticated thing was last: taken at once, up to several times the rate of a thing.
        # More is lost, as the address may be forged.
        bucket = self._things[address] = self._things.get(address) or TokenBucket(RATE, BURST)
        if bucket.refill(now) < 1:
            self.lost += 1
            return False
        bucket.tokens -= 1
        return True

    def put(self, data: bytes, address: Address) -> None:
        network = _network_of(str(address[0]))
        host = self._waiting.get(network) or _Host()
        if self._count >= OF_ALL or not host.put(data, address):
            self.lost += 1
            return
        self._waiting[network] = host
        self._count += 1

    def take(self) -> tuple[bytes, Address] | None:
        if not self._waiting:
            return None
        # Hosts take turns (of IPv6 networks of 64 bits), and of one host its ports: who sends much is late.
        network, host = self._waiting.popitem(last=False)
        taken = host.take()
        if host:
            self._waiting[network] = host
        self._count -= 1
        return taken
