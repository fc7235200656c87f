"""A topic this node subscribes to: one connection to each publisher the master lists.

The master provides the addresses of publishers only. Their identity comes from the channel, their right to
publish from the grant they present. A publisher that refuses, or is refused, is tried again with growing
pauses for as long as the master lists it: a grant may arrive later.
"""

import asyncio
import logging
import re
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from time import monotonic
from typing import Any, Final, Protocol, TypeAlias

from ca.certificates import Identity
from ca.errors import HintedError
from ca.names import shown
from grants.decision import Decision
from grants.errors import GrantError
from grants.filters.layout import MAX_TEXT, TYPE_NAME
from grants.guard import Guard, MemoryScope
from rossec import clock
from rossec.errors import ConfigurationError, ConnectionHeaderRefused, MessageError
from rossec.host.runner import TaskSet
from rossec.net.aio import SecureStream
from rossec.net.aio.stream import next_messages
from rossec.net.limits import message_limit, unit_limit
from rossec.node.context import NodeConnection, NodeContext
from rossec.participant import delivery_options
from rossec.participant.access import FIELD, granted_name
from rossec.participant.authorized import AuthorizedConnection
from rossec.participant.definitions import Definition, from_header, guard_for, receiver_definition, size_of
from rossec.participant.handshakes import Fields, TopicEndpoint, admit_publisher, subscriber_header
from rossec.participant.host_types import known_type
from rossec.participant.message_types import Message, MessageType
from rossec.ros import tcpros
from rossec.ros.names import ANY_TYPE

QUEUE_SIZE: Final = 10
HANDSHAKE_DEADLINE: Final = 5.0
_FIRST_PAUSE: Final = 0.25
LONGEST_PAUSE: Final = 15.0
ANY: Final = MessageType(ANY_TYPE, ANY_TYPE, "")
_MD5: Final = re.compile(r"[0-9a-f]{32}")

PublisherConnection: TypeAlias = NodeConnection[Guard | None]
OnClose = Callable[["Subscriber"], Awaitable[None]]
_log = logging.getLogger("rossec.node")


class RequestedMessages:
    """The messages of one connection that was asked for with options; `limit`: how many bytes one may have.

    Inflates what the publisher deflates, never much in one turn of the loop. A publisher may take no option:
    then messages are thinned out here, which spares the program and not the line.
    """

    def __init__(
        self, asked: delivery_options.DeliveryOptions, taken: delivery_options.DeliveryOptions, limit: int
    ) -> None:
        thins = asked.rate is not None and taken.rate is None
        self._rate = delivery_options.RequestedRate(asked.rate) if asked.rate is not None and thins else None
        self._deflated = taken.deflate
        self._limit = limit
        self._this_turn = 0  # bytes inflated since the loop had its turn

    async def inflated(self, content: bytes) -> bytes:
        if not self._deflated:
            return content
        size = delivery_options.claimed_size(content, self._limit)
        if size >= delivery_options.LARGE:
            return await asyncio.to_thread(delivery_options.inflated, content, self._limit)
        self._this_turn += size
        if self._this_turn >= delivery_options.LARGE:  # thousands of small bombs fit into one unit
            self._this_turn = 0
            await asyncio.sleep(0)
        return delivery_options.inflated(content, self._limit)

    def admits(self) -> bool:
        return self._rate is None or self._rate.admits(monotonic())


def requested_messages(
    asked: delivery_options.DeliveryOptions, answer: Mapping[str, bytes], limit: int
) -> RequestedMessages | None:
    """For a publisher with this answer; None: its messages come as they do without options."""
    taken = delivery_options.accepted_options(answer, asked)
    if taken.deflate or taken.rate != asked.rate:
        return RequestedMessages(asked, taken, limit)
    return None


class Subscriber:
    """Receives messages of one type on one topic; iterate over it. Made by `Node.subscriber`."""

    def __init__(
        self,
        endpoint: TopicEndpoint,
        context: NodeContext,
        on_close: OnClose,
        memory_scope: MemoryScope,
        *,
        queue_size: int = QUEUE_SIZE,
        options: delivery_options.DeliveryOptions = delivery_options.NO_OPTIONS,
    ) -> None:
        check_queue_size(queue_size)
        self.endpoint = endpoint
        self.links: set[PublisherConnection] = set()
        self.refusals: deque[HintedError] = deque(maxlen=16)
        self.received = 0
        self.updates = 0
        self.memory_scope = memory_scope
        self._context = context
        self._on_close = on_close
        self._options = options
        self._size = size_of(endpoint.type)
        self._longest = message_limit(self._size, tcpros.MESSAGE_LIMIT)
        self._task_set = TaskSet()
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._queue: deque[bytes] = deque(maxlen=queue_size)
        self._wake = asyncio.Event()
        self._closed = False
        self._last_reason = ""

    @property
    def topic(self) -> str:
        return self.endpoint.topic

    @property
    def publishers(self) -> list[str]:
        return list(self._tasks)

    def update(self, publishers: list[str]) -> None:
        """Connect to exactly `publishers` (API URIs), the master's list."""
        if self._closed:
            return
        self.updates += 1
        for uri in self._tasks.keys() - set(publishers):
            self._tasks.pop(uri).cancel()
        for uri in set(publishers) - self._tasks.keys():
            self._tasks[uri] = self._task_set.spawn(self._follow(uri), f"{self.topic} from {uri}")

    async def messages(self) -> AsyncIterator[Message]:
        """Messages as they arrive; ends when the node closes. A malformed one is dropped."""
        async for data in self.raw():
            try:
                message = self.endpoint.type.deserialize(data)
            except MessageError as error:
                delivery_options.warn(
                    _log, "%(where)s: dropped a message: %(cause)s", shown(self.topic), "", error
                )
            else:
                yield message

    def __aiter__(self) -> AsyncIterator[Message]:
        return self.messages()

    async def raw(self) -> AsyncIterator[bytes]:
        """Serialized messages as they arrive, without their length prefix."""
        while not self._closed:
            while self._queue:
                yield self._queue.popleft()
            self._wake.clear()
            await self._wake.wait()

    async def close(self) -> None:
        """Close every connection, end the iterators, unregister. Safe to call twice."""
        if self._closed:
            return
        self._closed = True
        self._wake.set()
        self._tasks.clear()
        await self._task_set.close()
        await self._on_close(self)

    async def _follow(self, uri: str) -> None:
        pause = _FIRST_PAUSE
        while True:
            before = self.received
            try:
                await self._receive_from(uri)
            except Exception as error:  # noqa: BLE001 - after any error try again later
                self._record_failure(uri, error)
            # Longer only while nothing comes: one that was received from is tried again soon.
            pause = _FIRST_PAUSE if self.received > before else min(2 * pause, LONGEST_PAUSE)
            await asyncio.sleep(pause)

    async def _receive_from(self, uri: str) -> None:
        # The whole way has one deadline: a publisher that stalls holds no descriptor for longer.
        async with asyncio.timeout(HANDSHAKE_DEADLINE):
            stream = await self._context.dialer.topic(uri, self.topic)
            try:
                limit = self._longest + (delivery_options.OVERHEAD if self._options.deflate else 0)
                frames = tcpros.FrameReader(limit, first=tcpros.HEADER_LIMIT)
                connection, answer, early = await self._handshake(stream, frames)
                requested = requested_messages(self._options, answer, self._longest)
            except BaseException:
                stream.abort("the connection header was refused")
                raise
        self.links.add(connection)
        try:
            with self._context.connections.track(connection):
                self._opened(connection, answer)
                framing, messages = tcpros.Framing(frames), early
                while True:
                    if requested is None:
                        self._deliver(connection, messages)
                    else:
                        for content in messages:
                            message = await requested.inflated(content)
                            # That took its time, in which the right may have ended.
                            self._context.connections.check(connection)
                            self._deliver(connection, [message], requested)
                    messages = await next_messages(stream, framing)
        finally:
            self.links.discard(connection)
            stream.abort("no longer subscribed")
            self._ended(connection)

    async def _handshake(
        self, stream: SecureStream[Identity], frames: tcpros.FrameReader
    ) -> tuple[PublisherConnection, Fields, list[bytes]]:
        context = self._context
        name = context.name_for(stream.peer)
        own = context.certified or context.name
        # A gateway of the own domain is asked by the name under which it serves the alias (0035).
        endpoint = replace(self.endpoint, topic=granted_name(stream.peer, self.topic, own))
        fields = subscriber_header(name, endpoint, context.access, clock.now())
        await stream.send(tcpros.encode(fields | self._options.fields))
        units: list[bytes] = []
        while not units:
            units = frames.feed(await stream.receive())
        answer = tcpros.decode(units[0])
        kind, now = endpoint.type, clock.now()
        decision = admit_publisher(answer, stream.peer, endpoint.topic, kind, context.access, now)
        # Of a type of fixed size a unit needs less than the most that any type may have.
        stream.raise_unit_limit(unit_limit(self._size, tcpros.MESSAGE_LIMIT))
        del answer[FIELD]  # what is kept of it needs no grants

        def rebuild(decision: Decision) -> Guard | None:
            kind = self._read_as(answer, decision)
            return guard_for(kind, decision, context.filter_key, self.memory_scope)

        connection = AuthorizedConnection(stream, decision, rebuild(decision), rebuild)
        return connection, answer, units[1:]

    # -- what a raw subscriber does in another way

    def _read_as(self, _answer: Fields, _decision: Decision) -> Definition:
        return self.endpoint.type

    def _opened(self, connection: PublisherConnection, answer: Fields) -> None: ...
    def _ended(self, connection: PublisherConnection) -> None: ...

    def _keep(self, _connection: PublisherConnection, messages: list[bytes]) -> None:
        self._queue.extend(messages)
        self._wake.set()

    def _deliver(
        self,
        connection: PublisherConnection,
        messages: list[bytes],
        requested: RequestedMessages | None = None,
    ) -> None:
        if connection.guard is not None:
            peer = shown(connection.stream.peer.name)
            messages = self._filtered(connection.guard, messages, peer, clock.time())
        if messages and (requested is None or requested.admits()):
            self.received += len(messages)
            self._keep(connection, messages)

    def _filtered(self, guard: Guard, messages: list[bytes], peer: str, now: float) -> list[bytes]:
        filtered = []
        for message in messages:
            try:
                pieces = guard(message, now)
            except GrantError as error:
                delivery_options.warn(_log, delivery_options.RECEIVED, shown(self.topic), peer, error)
            else:
                filtered += [] if pieces is None else [b"".join(pieces)]
        return filtered

    def _record_failure(self, uri: str, error: Exception) -> None:
        # Log a failure; the same one again at level INFO only, as every attempt may repeat it.
        if isinstance(error, HintedError):
            self.refusals.append(error.bare())
        reason = f"{shown(self.topic)} from {uri}: {str(error) or type(error).__name__}"
        unexpected = not isinstance(error, HintedError | OSError)
        level = logging.INFO if reason == self._last_reason else logging.WARNING
        _log.log(level, "%s", reason, exc_info=error if unexpected else None)
        self._last_reason = reason


def check_queue_size(size: int) -> None:
    """Refuse a size below 1 (in rospy 0 means unbounded, but memory is not)."""
    if size < 1:
        raise ConfigurationError(f"a queue of {size} messages", "queue_size must be 1 or more")


@dataclass(frozen=True, eq=False)
class RawSource:
    peer: str  # its certified name, of a foreign one its alias
    type: Definition  # of its messages, as it claims
    latching: bool  # whether it sends new subscribers the last message, as it claims


class RawReceiver(Protocol):
    """What takes messages; each publisher is connected once, then gone once."""

    def connected(self, source: RawSource) -> None:
        """A publisher is connected; raises HintedError: it is not wanted; it is tried again later."""

    def received(self, source: RawSource, messages: Sequence[bytes]) -> None:
        """Serialized messages, without their length prefixes."""

    def disconnected(self, source: RawSource) -> None:
        """A publisher is connected no longer."""

    def refused(self, error: Exception) -> None:
        """A publisher could not be connected, or the connection ended."""


class RawSubscriber(Subscriber):
    """Hands what arrives, of any type, to a receiver: it takes each message at once. Made by
    `Topics.subscribe_raw`.

    Type and md5sum of the subscription are `*`, as in ROS; what a publisher answers with says what its
    messages are, and is handed on with them. Nothing of it is trusted: where a right of the publisher is
    restricted, the restriction is applied by the definition that is installed here.
    """

    def __init__(self, topic: str, receiver: RawReceiver, *given: Any, **options: Any) -> None:
        super().__init__(TopicEndpoint(topic, ANY), *given, **options)
        self._receiver = receiver
        self._sources: dict[PublisherConnection, RawSource] = {}

    def _read_as(self, answer: Fields, decision: Decision) -> Definition:
        return receiver_definition(ANY, claimed(answer), decision, known_type)

    def _opened(self, connection: PublisherConnection, answer: Fields) -> None:
        latching = answer.get("latching") == b"1"
        source = RawSource(connection.stream.peer.name, claimed(answer), latching)
        self._receiver.connected(source)
        self._sources[connection] = source

    def _keep(self, connection: PublisherConnection, messages: list[bytes]) -> None:
        self._receiver.received(self._sources[connection], messages)

    def _ended(self, connection: PublisherConnection) -> None:
        if (source := self._sources.pop(connection, None)) is not None:
            self._receiver.disconnected(source)

    def _record_failure(self, uri: str, error: Exception) -> None:
        super()._record_failure(uri, error)
        self._receiver.refused(error)


def claimed(answer: Fields) -> Definition:
    """The type a publisher says its messages have, in form."""
    found = from_header(answer)
    if TYPE_NAME.fullmatch(found.name) is None or _MD5.fullmatch(found.md5sum) is None:
        raise ConnectionHeaderRefused(f"a publisher of {found.name[:80]!a}, which is no type")
    if len(found.definition) > MAX_TEXT:
        raise ConnectionHeaderRefused(f"a definition of {len(found.definition)} characters")
    return found
