"""Bytes between a program and a peer, once both have introduced themselves.

A shell. What is not restricted passes as it comes, without a look at it; what is goes through the
guard, message by message. Whoever lags slows the other end down, or misses messages where the guard
remembers some. When one end goes the other goes, after it got what was sent; when anything is
wrong, a guard that fails included, both go at once.
"""

import asyncio
import logging
import struct
from collections.abc import Coroutine
from typing import Final

from ca.certificates import Identity
from grants.errors import GrantError
from rossec import clock
from rossec.errors import ChannelClosed, ConnectionHeaderRefused, HeaderRefused
from rossec.net import withheld_log
from rossec.net.aio import SecureStream
from rossec.net.aio.arrivals import next_messages
from rossec.participant.header_fields import Fields
from rossec.ros import header
from rossec.ros.framing import Framing
from rossec.ros.header import MESSAGE_LIMIT, FrameReader
from rossec.sidecar.core.copies import MessageGuard, SharedGuard
from rossec.sidecar.plain_stream import PlainStream

_LENGTH: Final = struct.Struct("<I")
_log = logging.getLogger("rossec.sidecar")
Buffer = bytes | bytearray | memoryview


async def split_header(end: PlainStream | SecureStream[Identity]) -> tuple[Fields, bytes]:
    """The connection header that `end` sends first, and the bytes that came with it.

    Raises:
        HeaderRefused: malformed or too long; the limit is checked before anything is kept.
        ChannelError: the end is gone.
    """
    data = b""
    while len(data) < _LENGTH.size or len(data) < _LENGTH.size + _length(data):
        data += await end.receive()
    size = _LENGTH.size + _length(data)
    return header.decode(data[_LENGTH.size : size]), data[size:]


def _length(data: bytes) -> int:
    (length,) = _LENGTH.unpack_from(data)
    if length > header.HEADER_LIMIT:
        raise HeaderRefused(f"a connection header of {length} bytes")
    return int(length)


async def exchange(
    program: PlainStream, peer: SecureStream[Identity], outward: bytes, inward: bytes
) -> None:
    """Pass bytes both ways, as a service needs; what came with the headers goes first."""
    await _both(program, peer, to_peer(program, peer, outward), to_program(peer, program, inward))


async def publish(
    program: PlainStream, peer: SecureStream[Identity], guard: MessageGuard | None, first: bytes
) -> None:
    """Pass a program's messages to a peer that subscribes; `first` came with its header."""
    await _both(program, peer, outgoing(program, peer, guard, first), _nothing_more(peer))


async def subscribe(
    program: PlainStream,
    peer: SecureStream[Identity],
    guard: MessageGuard | None,
    first: bytes,
    longest: int = MESSAGE_LIMIT,
) -> None:
    """Pass a peer's messages to a program that subscribes; a guard takes none above `longest`."""
    way = incoming(peer, program, guard, first, longest)
    await _both(program, peer, way, _nothing_more(program))


async def to_peer(program: PlainStream, peer: SecureStream[Identity], first: bytes) -> None:
    """Everything the program sends, until it ends."""
    if first:
        await peer.send(first)
    await program.forward(peer.write_nowait, peer.drain)


async def to_program(peer: SecureStream[Identity], program: PlainStream, first: bytes) -> None:
    """Everything the peer sends, until it ends."""
    if first:
        await program.send(first)
    await peer.forward(program.write_nowait, program.drain)


def outgoing(
    program: PlainStream, peer: SecureStream[Identity], guard: MessageGuard | None, first: bytes
) -> Coroutine[None, None, None]:
    """The way of messages out: through the guard if there is one."""
    if guard is None:
        return to_peer(program, peer, first)
    if isinstance(guard, SharedGuard):
        return send_filtered_nowait(program, peer, guard, first)
    return send_filtered(program, peer, guard, first)


def incoming(
    peer: SecureStream[Identity],
    program: PlainStream,
    guard: MessageGuard | None,
    first: bytes,
    longest: int = MESSAGE_LIMIT,
) -> Coroutine[None, None, None]:
    """The way of messages in: through the guard if the publisher is restricted."""
    if guard is None:
        return to_program(peer, program, first)
    return send_filtered(peer, program, guard, first, longest)


async def send_filtered(
    source: PlainStream | SecureStream[Identity],
    sink: PlainStream | SecureStream[Identity],
    guard: MessageGuard,
    first: bytes,
    longest: int = MESSAGE_LIMIT,
) -> None:
    """Each message as the guard leaves it; one that cannot be judged is withheld.

    Raises:
        GrantExpired, ChannelClosed: the right, or one of the ends, has ended.
        FrameRefused: the messages cannot be told apart.
        LimitExceeded: one that was begun does not get on.
    """
    framing = Framing(FrameReader(longest))
    (peer,) = (end.peer.name for end in (source, sink) if not isinstance(end, PlainStream))
    messages = framing.feed(first, clock.now())
    while True:
        now = clock.now()
        guard.check(now)
        pieces = _filter_messages(guard, messages, peer, now)
        if pieces:
            await sink.send(*pieces)
        messages = await next_messages(source, framing)


async def send_filtered_nowait(
    program: PlainStream, peer: SecureStream[Identity], guard: SharedGuard, first: bytes
) -> None:
    """As `guarded`; a message is judged when the program sends it, and a peer that lags misses it.

    Connections of a key share what is remembered. On one that waits for its reader old messages
    would be judged after new ones, and set a field with hysteresis anew whenever the reader likes.
    """
    framing = Framing(FrameReader())
    messages = framing.feed(first, clock.now())
    while True:
        now = clock.now()
        guard.check(now)
        pieces = [] if peer.lags else _filter_messages(guard, messages, peer.peer.name, now)
        if pieces:
            peer.write_nowait(b"".join(pieces))
        messages = await next_messages(program, framing)


def _filter_messages(
    guard: MessageGuard, messages: list[bytes], peer: str, now: int
) -> list[Buffer]:
    """What the guard leaves of the messages, as it is sent."""
    return [piece for message in messages for piece in _filter_message(guard, message, peer, now)]


def _filter_message(guard: MessageGuard, message: bytes, peer: str, now: int) -> list[Buffer]:
    try:
        treated = guard.apply(message, now)
    except GrantError as error:
        withheld_log.warn(_log, "%(peer)s: withheld a message: %(cause)s", "", peer, error)
        return []
    return framed(treated or [])


def framed(pieces: list[Buffer]) -> list[Buffer]:
    """A message as it is sent, if there is one."""
    return [_LENGTH.pack(sum(map(len, pieces))), *pieces] if pieces else []


async def _nothing_more(end: PlainStream | SecureStream[Identity]) -> None:
    """A subscriber sends nothing after its header."""
    await end.receive()
    raise ConnectionHeaderRefused("a subscriber that sends data")


async def _both(
    program: PlainStream, peer: SecureStream[Identity], *ways: "asyncio._CoroutineLike[None]"
) -> None:
    try:
        async with asyncio.TaskGroup() as group:
            for way in ways:
                group.create_task(way)
    except* ChannelClosed:  # in order: what was sent is delivered before the other end goes
        await asyncio.gather(program.close(), peer.close())
    finally:
        program.abort()
        peer.abort("the other end is gone")
