"""How a subscriber is sent messages: its options, the latched message, and what is said of withheld ones.

Fields of the connection header (docs/spec/transport.md section 2.1): the subscriber's say what it asks for,
the answer's what this publisher carries out; one that knows none ignores them all. A delivery option never
gives more than the grant: guards come first, and what they let through is thinned out, kept back or made
smaller; what is filtered or withheld is never deflated. What programs write into these fields is not passed
on: an agent that forwards bytes could not read what came of it.
"""

import asyncio
import logging
import re
import struct
import zlib
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from threading import Lock
from time import monotonic
from typing import Final, Generic, TypeVar
from weakref import WeakKeyDictionary, ref

from ca.certificates import Identity
from ca.errors import HintedError
from grants.decision import Decision
from grants.filters.layout import Buffer
from grants.guard import Guard, Memory
from grants.limits import TokenBucket
from rossec.errors import ConfigurationError, ConnectionHeaderRefused, WireError
from rossec.net.aio import SecureStream
from rossec.participant.handshakes import Fields
from rossec.peer_limits import CAUSE, LogRateLimit

RATE: Final = "rossec_rate"
NEWEST: Final = "rossec_newest"
DEFLATE: Final = "rossec_deflate"
_FIELDS: Final = frozenset((RATE, NEWEST, DEFLATE))
_LOWEST, _HIGHEST = 0.001, 10_000
_RATE: Final = re.compile(rb"[0-9]{1,5}(\.[0-9]{1,3})?")
_YES: Final = b"1"
_AT_ONCE: Final = (
    2.0  # with room for one alone, a message that comes a moment early would cost a whole interval
)

STORED, DEFLATED = b"\0", b"\1"
OVERHEAD: Final = 1
"""Bytes that a content is longer than its message at most."""
LARGE: Final = 64 * 1024
"""A message from this size on is not deflated, or inflated, in the turn of an event loop."""
_LEVEL: Final = 1  # higher ones take twice to four times as long, for a few per cent
_SHORTEST: Final = 64  # bytes; below it there is nothing to gain
_RAW: Final = -zlib.MAX_WBITS  # no header and no checksum: the channel authenticates
_SIZE: Final = struct.Struct("<I")
_START: Final = len(DEFLATED) + _SIZE.size
_LAGGING: Final = 64 * 1024  # bytes that wait, above which a peer lags

SENT: Final = "%(where)s: withheld from %(peer)s: %(cause)s"
RECEIVED: Final = "%(where)s: withheld a message of %(peer)s: %(cause)s"
REFUSED: Final = "%(where)s: refused %(peer)s: %(cause)s"
UNREACHED: Final = "%(where)s: not connected to %(peer)s: %(cause)s%(hint)s"
RATE_LIMIT: Final = LogRateLimit()
_LOCK: Final = Lock()  # rospy's connections have threads

Data = TypeVar("Data", bytes, memoryview)


@dataclass(frozen=True)
class DeliveryOptions:
    """The options for one connection; false if there are none."""

    rate: float | None = None  # messages a second at most, 0.001 to 10000, to three decimals; None: all
    newest: bool = False  # of the messages that wait for a slow line only the newest is sent
    deflate: bool = False  # messages are sent compressed

    def __post_init__(self) -> None:
        if self.rate is None:
            return
        if not _LOWEST <= self.rate <= _HIGHEST:  # false for what is no number, too
            raise ConfigurationError(
                f"a rate of {self.rate} messages a second", f"it must be from {_LOWEST} to {_HIGHEST}"
            )
        object.__setattr__(self, "rate", round(float(self.rate), 3))

    def __bool__(self) -> bool:
        return self != NO_OPTIONS

    @property
    def fields(self) -> Fields:
        found = {} if self.rate is None else {RATE: f"{self.rate:.3f}".encode()}
        found |= {NEWEST: _YES} if self.newest else {}
        return found | ({DEFLATE: _YES} if self.deflate else {})


NO_OPTIONS: Final = DeliveryOptions()


def requested_options(fields: Mapping[str, bytes]) -> DeliveryOptions:
    if _FIELDS.isdisjoint(fields):
        return NO_OPTIONS
    value, rate = fields.get(RATE), None
    if value is not None:
        if not _RATE.fullmatch(value) or not _LOWEST <= float(value) <= _HIGHEST:
            raise ConnectionHeaderRefused(
                f"the connection header's {RATE!r} is no rate", f"it is a decimal, {_LOWEST} to {_HIGHEST}"
            )
        rate = float(value)
    return DeliveryOptions(rate, _is_set(fields, NEWEST), _is_set(fields, DEFLATE))


def carried_out(options: DeliveryOptions, decision: Decision) -> DeliveryOptions:
    """What a publisher carries out for a right: nothing filtered, withheld or padded is deflated.

    Encryption leaves the length of a message visible. That of a filtered one has few values, and deflated it
    depends on them: whoever sees the network, without any grant, would read the cell.
    """
    restrictions = decision.restrictions
    if any(each.filters or each.conditions or each.slot or each.pad for each in restrictions):
        return replace(options, deflate=False)
    return options


def check_carried_out(options: DeliveryOptions, decision: Decision) -> None:
    """Return if the options that are carried out on a connection may be under another decision."""
    if carried_out(options, decision) != options:
        raise ConnectionHeaderRefused("messages that are filtered now were to be sent deflated")


def accepted_options(answer: Mapping[str, bytes], asked: DeliveryOptions) -> DeliveryOptions:
    """What the publisher with this answer carries out: those that were asked, or some of them."""
    taken = requested_options(answer)
    if taken.rate not in (None, asked.rate) or taken.newest > asked.newest:
        raise ConnectionHeaderRefused("the publisher answers another delivery option than it was asked")
    if taken.deflate > asked.deflate:
        raise ConnectionHeaderRefused("the publisher deflates messages, and was not asked to")
    return taken


def without_options(fields: Mapping[str, bytes]) -> Fields:
    return {key: value for key, value in fields.items() if key not in _FIELDS}


def _is_set(fields: Mapping[str, bytes], key: str) -> bool:
    value = fields.get(key)
    if value not in (None, _YES):
        raise ConnectionHeaderRefused(f"the connection header's {key!r} is not 1")
    return value is not None


class RequestedRate:
    """Admits `rate` messages a second on average, and never more than two at once.

    Not the rate of a grant, which is a limit and belongs to the holder's key (`grants.guard`): this one
    belongs to a connection and only ever takes away, whatever a message's content.
    """

    def __init__(self, rate: float) -> None:
        self._bucket = TokenBucket(rate, _AT_ONCE)

    def admits(self, now: float) -> bool:
        """Whether the message that is there at `now` is sent; seconds, of a clock never set."""
        if self._bucket.refill(now) < 1:
            return False
        self._bucket.tokens -= 1
        return True


# Messages deflated for a slow line (RFC 1951), and inflated within bounds. A deflated connection carries
# TCPROS frames whose content is `00 message`, or `01 size data`, with the size of the message in 4 bytes,
# little endian. Each message is compressed for itself: no length depends on another one, so none tells what a
# grant withheld; after filters, so its length tells no more than what its receiver reads. `size` is compared
# with the limit before anything is inflated, and no more than that many bytes ever are; a bomb costs what a
# message of that size costs, and ends its connection.


def deflated(pieces: Sequence[Buffer]) -> bytes:
    """The content for a message in pieces: deflated if it is shorter then, else as it is."""
    size = sum(map(len, pieces))
    if size >= _SHORTEST:
        engine = zlib.compressobj(_LEVEL, zlib.DEFLATED, _RAW)
        parts = [*map(engine.compress, pieces), engine.flush()]
        content = b"".join((DEFLATED, _SIZE.pack(size), *parts))
        if len(content) <= size:
            return content
    return b"".join((STORED, *pieces))


def claimed_size(content: bytes, limit: int) -> int:
    if content[:1] == STORED:
        size = len(content) - 1
    elif content[:1] == DEFLATED and len(content) > _START:
        (size,) = _SIZE.unpack_from(content, 1)
        if size < len(content):
            raise WireError(f"a message of {size} bytes that is longer when deflated")
    else:
        raise WireError("a frame that is neither deflated nor as it is")
    if size > limit:
        raise WireError(f"a deflated message of {size} bytes, at most {limit} allowed")
    return size


def inflated(content: bytes, limit: int) -> bytes:
    """The message of `content`, at most `limit` bytes."""
    size = claimed_size(content, limit)
    if content[:1] == STORED:
        return content[1:]
    engine = zlib.decompressobj(_RAW)
    try:
        # One byte more, for the end of the data to be read; zero would mean no limit.
        message = engine.decompress(memoryview(content)[_START:], size + 1)
    except zlib.error:
        raise WireError("a deflated message that cannot be inflated") from None
    if len(message) != size or not engine.eof or engine.unused_data:
        raise WireError(f"a deflated message that has not the {size} bytes it says")
    return message


@dataclass(eq=False, slots=True, weakref_slot=True)
class Deflatable:
    """A message that is deflated once, when it is first sent; threads share it."""

    pieces: Sequence[Buffer]
    source: object
    _content: bytes | None = field(default=None, init=False)
    _lock: Lock = field(default_factory=Lock, init=False)

    def content(self) -> bytes:
        with self._lock:
            if self._content is None:
                self._content = deflated(self.pieces)
            return self._content


class SharedDeflation:
    """Gives the receivers of one filtered message the same `Deflatable`.

    It keeps a small one until the next message: it may be sent before it is queued for the next receiver. A
    large one takes longer than that, and its memory is freed with the last receiver.
    """

    def __init__(self) -> None:
        self._last: ref[Deflatable] | None = None
        self._kept: Deflatable | None = None

    def of(self, pieces: Sequence[Buffer], source: object) -> Deflatable:
        """That of the message in `pieces`: the last one, if `source` is the object it was then."""
        last = None if self._last is None else self._last()
        if last is None or last.source is not source:
            last = Deflatable(pieces, source)
            self._last = ref(last)
            self._kept = last if sum(map(len, pieces)) < LARGE else None
        return last


class DeliveryQueue:
    """What waits for one subscriber with `options`: thinned out, the newest only, deflated.

    What comes here has passed the guard. `most`: how many messages wait; None: whoever fills it asks `lags`,
    or waits until it is `idle`.
    """

    def __init__(
        self,
        stream: SecureStream[Identity],
        options: DeliveryOptions,
        most: int | None = None,
        deflation: SharedDeflation | None = None,
    ) -> None:
        self.newest = options.newest
        self.withheld = self.dropped = 0
        self.thinned = 0  # messages that the rate took away
        self._stream = stream
        self._deflate = options.deflate
        self._deflation = SharedDeflation() if deflation is None else deflation
        self._rate = None if options.rate is None else RequestedRate(options.rate)
        self._most = 1 if options.newest else most
        self._held = 0  # bytes that wait
        self._queue: deque[Deflatable] = deque()
        self._wake, self._idle = asyncio.Event(), asyncio.Event()
        self._idle.set()
        if options.newest:
            stream.transport.limit_unsent()

    @property
    def lags(self) -> bool:
        return self._held > _LAGGING or self._stream.lags

    async def idle(self) -> None:
        await self._idle.wait()

    def enqueue(self, pieces: Sequence[Buffer]) -> None:
        """Queue one filtered message, unless the rate takes it away; the oldest gives way."""
        # The guard has let it pass: an option only ever takes away (0036).
        if self._rate is not None and not self._rate.admits(monotonic()):
            self.thinned += 1
            return
        if self._most is not None and len(self._queue) >= self._most:
            self._held -= sum(map(len, self._queue.popleft().pieces))
            self.dropped += 1
        self._queue.append(self._deflation.of(pieces, pieces))
        self._held += sum(map(len, pieces))
        self._idle.clear()
        self._wake.set()

    async def run(self) -> None:
        # One by one: for the newest to be sent, a message is taken from the queue, and deflated, only when
        # those before it have left.
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._queue:
                if self.newest:
                    await self._stream.flushed()
                message = self._queue.popleft()
                pieces, size = message.pieces, sum(map(len, message.pieces))
                self._held -= size
                if self._deflate:
                    large = size >= LARGE
                    pieces = [await asyncio.to_thread(message.content) if large else message.content()]
                    size = len(pieces[0])
                await self._stream.send(_SIZE.pack(size), *pieces)
            self._idle.set()


@dataclass(frozen=True)
class Sample(Generic[Data]):
    """A serialized message; guards identify it by its mark."""

    data: Data
    mark: object = field(default_factory=object)


class Latch(Generic[Data]):
    """The latched messages of one topic: a new subscriber is sent the newest, if the rate allows it.

    Otherwise the last one that was sent to the same key, which reveals nothing new. A restarted program
    receives what it had; reconnecting again and again reveals no more than staying connected.
    """

    def __init__(self) -> None:
        self.newest: Sample[Data] | None = None  # the last message published
        self._seen: WeakKeyDictionary[Memory, Sample[Data]] = WeakKeyDictionary()

    def record(self, guard: Guard, sample: Sample[Data]) -> None:
        if guard.memory is not None:
            self._seen[guard.memory] = sample

    def candidates(self, guard: Guard) -> Iterator[Sample[Data]]:
        if self.newest is not None:
            yield self.newest
        if guard.memory is not None and guard.memory in self._seen:
            yield self._seen[guard.memory]


def warn(log: logging.Logger, text: str, where: str, peer: str, cause: object) -> None:
    """Log `text`, filled in with the place, the peer and the cause, unless it is rate-limited.

    A peer with a limited grant decides how many of its messages are malformed or not allowed, and must not
    fill the disk of the node that applies the limit: one line for each cause and peer in a minute, with the
    count of those left out.
    """
    if not log.isEnabledFor(logging.WARNING):
        return
    kind = type(cause).__name__ if isinstance(cause, Exception) else cause
    hint = f" ({cause.hint})" if isinstance(cause, HintedError) and cause.hint else ""
    args = {"where": where, "peer": peer, "cause": cause, "hint": hint}
    record = log.makeRecord(log.name, logging.WARNING, "", 0, text, (args,), None)
    setattr(record, CAUSE, (f"{log.name} {where} {peer} {kind}", peer))
    with _LOCK:
        allowed = RATE_LIMIT.filter(record)
    if allowed:
        log.handle(record)
