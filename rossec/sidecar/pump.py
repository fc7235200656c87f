"""Forwards bytes between a program and a peer, after the TCPROS handshake. A shell.

Unrestricted bytes are forwarded without inspection; restricted messages pass the guard one by one. An
end that lags slows the other end down, or misses messages if the guard keeps state.
"""

import asyncio
import contextlib
import logging
import struct
from collections.abc import Iterator
from typing import Final, TypeAlias

from ca.certificates import Identity
from ca.errors import HintedError
from ca.names import shown
from grants.errors import GrantError
from rossec import clock
from rossec.errors import ChannelClosed, ConnectionHeaderRefused, HeaderRefused
from rossec.net.aio import SecureStream
from rossec.net.aio.stream import next_messages
from rossec.participant import delivery_options
from rossec.participant.delivery_options import DeliveryQueue
from rossec.participant.handshakes import Fields
from rossec.ros import tcpros
from rossec.ros.tcpros import MESSAGE_LIMIT, FrameReader, Framing
from rossec.sidecar.core.guards import MessageGuard, SharedGuard
from rossec.sidecar.loopback_port import PlainStream

End: TypeAlias = PlainStream | SecureStream[Identity]
_LENGTH: Final = struct.Struct("<I")
_log = logging.getLogger("rossec.sidecar")
Buffer = bytes | bytearray | memoryview


async def split_header(end: End) -> tuple[Fields, bytes]:
    """The connection header that `end` sends first, and the bytes that came after it."""
    data, size = b"", _LENGTH.size
    while len(data) < size:
        data += await end.receive()
        if size == _LENGTH.size and len(data) >= size:
            (length,) = _LENGTH.unpack_from(data)
            if length > tcpros.HEADER_LIMIT:  # before it is buffered
                raise HeaderRefused(f"a connection header of {length} bytes")
            size += length
    return tcpros.decode(data[_LENGTH.size : size]), data[size:]


@contextlib.contextmanager
def log_end(peer: str) -> Iterator[None]:
    try:
        yield
    except* HintedError as group:  # also the guard's: a grant that expires between two messages
        _log.info("the connection with %s ended: %s", peer, group.exceptions[0])


async def exchange(program: PlainStream, peer: SecureStream[Identity], outward: bytes, inward: bytes) -> None:
    """Forward bytes in both directions, for a service; the bytes after the headers go first."""
    await run_both(program, peer, to_peer(program, peer, outward), to_program(peer, program, inward))


async def publish(
    program: PlainStream, peer: SecureStream[Identity], guard: MessageGuard | None, initial: bytes
) -> None:
    if guard is None:
        direction = to_peer(program, peer, initial)
    elif isinstance(guard, SharedGuard):
        direction = send_filtered_nowait(program, peer, guard, initial)
    else:
        direction = send_filtered(program, peer, guard, initial)
    await run_both(program, peer, direction, expect_no_data(peer))


async def subscribe(
    program: PlainStream,
    peer: SecureStream[Identity],
    guard: MessageGuard | None,
    initial: bytes,
    max_length: int = MESSAGE_LIMIT,
) -> None:
    """Forward a peer's messages to a subscribing program; a guard takes none above `max_length`."""
    if guard is None:
        direction = to_program(peer, program, initial)
    else:
        direction = send_filtered(peer, program, guard, initial, max_length)
    await run_both(program, peer, direction, expect_no_data(program))


async def to_peer(program: PlainStream, peer: SecureStream[Identity], initial: bytes) -> None:
    if initial:
        await peer.send(initial)
    await program.forward(peer.write_nowait, peer.drain)


async def to_program(peer: SecureStream[Identity], program: PlainStream, initial: bytes) -> None:
    if initial:
        await program.send(initial)
    await peer.forward(program.write_nowait, program.drain)


async def send_filtered(
    source: End, sink: End, guard: MessageGuard, initial: bytes, max_length: int = MESSAGE_LIMIT
) -> None:
    """Forward each message as the guard returns it; one that cannot be checked is withheld."""
    framing = Framing(FrameReader(max_length))
    (peer,) = (shown(end.peer.name) for end in (source, sink) if not isinstance(end, PlainStream))
    messages = framing.feed(initial, clock.now())
    while True:
        now = clock.time()
        guard.check(now)
        pieces = _filter_messages(guard, messages, peer, now)
        if pieces:
            await sink.send(*pieces)
        messages = await next_messages(source, framing)


async def send_filtered_nowait(
    program: PlainStream, peer: SecureStream[Identity], guard: SharedGuard, initial: bytes
) -> None:
    """As `send_filtered`, but each message is checked at once, and a lagging peer misses it."""
    # Connections of a key share the guard's state. If one could wait for its reader, old messages would be
    # checked after new ones, and the reader could reset a field with hysteresis at will.
    framing = Framing(FrameReader())
    messages = framing.feed(initial, clock.now())
    while True:
        now = clock.time()
        guard.check(now)
        pieces = [] if peer.lags else _filter_messages(guard, messages, shown(peer.peer.name), now)
        if pieces:
            peer.write_nowait(b"".join(pieces))
        messages = await next_messages(program, framing)


def _filter_messages(guard: MessageGuard, messages: list[bytes], peer: str, now: float) -> list[Buffer]:
    return [piece for message in messages for piece in framed(filtered(guard, message, peer, now))]


def filtered(guard: MessageGuard, message: bytes, peer: str, now: float) -> list[Buffer]:
    try:
        return guard.apply(message, now) or []
    except GrantError as error:
        delivery_options.warn(_log, "%(peer)s: withheld a message: %(cause)s", "", peer, error)
        return []


def framed(pieces: list[Buffer]) -> list[Buffer]:
    """A message with its length prefix; empty if there is none."""
    return [_LENGTH.pack(sum(map(len, pieces))), *pieces] if pieces else []


async def expect_no_data(end: End) -> None:
    await end.receive()
    raise ConnectionHeaderRefused("a subscriber that sends data")


async def run_both(
    program: PlainStream, peer: SecureStream[Identity], *directions: "asyncio._CoroutineLike[None]"
) -> None:
    # When one end closes, the other is closed after it got what was sent; on any error both are aborted.
    try:
        try:
            async with asyncio.TaskGroup() as group:
                for direction in directions:
                    group.create_task(direction)
        except* ChannelClosed:
            pass  # nothing is awaited in `except*`: a cancellation there would become a group, a crash
        await asyncio.gather(program.close(), peer.close())  # deliver what was sent
    finally:
        program.abort()
        peer.abort("the other end was closed")


async def publish_by_options(
    program: PlainStream,
    peer: SecureStream[Identity],
    guard: MessageGuard | None,
    initial: bytes,
    sender: DeliveryQueue,
) -> None:
    forwarding = forward_by_options(program, shown(peer.peer.name), guard, initial, sender)
    await run_both(program, peer, forwarding, sender.run(), expect_no_data(peer))


async def forward_by_options(
    program: PlainStream, peer: str, guard: MessageGuard | None, initial: bytes, sender: DeliveryQueue
) -> None:
    # The guard comes first, as without options: if it keeps state, or only the newest message is requested,
    # messages are checked as they come, and a peer that lags misses some; else it slows the program down.
    # What the program sent before it closed is delivered.
    framing = Framing(FrameReader())
    messages = framing.feed(initial, clock.now())
    keeps_state = isinstance(guard, SharedGuard)
    while True:
        now = clock.time()
        if guard is not None:
            guard.check(now)
        if sender.newest or not keeps_state or not sender.lags:
            for message in messages:
                pieces = [message] if guard is None else filtered(guard, message, peer, now)
                if pieces:
                    sender.enqueue(pieces)
        if not sender.newest and not keeps_state:
            await sender.idle()
        try:
            messages = await next_messages(program, framing)
        except ChannelClosed:
            await sender.idle()
            raise
