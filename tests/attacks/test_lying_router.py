"""A router does with frames what it likes: no byte is believed that the peer did not send.

It can end a link, as by dropping everything: then both ends know that something is missing.
"""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from random import Random  # noqa: TID251 - seeded, for reproducible failures
from typing import Any

import pytest

from rossec.channel.records import ChannelLimits
from rossec.errors import ChannelClosed, ChannelError, ConnectionTruncated
from rossec.overlay.endpoint import OPENS_PER_SECOND, LinkListener, dial_link
from rossec.overlay.link_frames import (
    HEAD,
    LINK_ID,
    OPEN_SIZE,
    LinkFrameKind,
    head,
    inbox,
    kind_of,
    read,
    return_address,
    split_return_address,
)
from tests.support.contexts import context
from tests.support.frame_carriers import MemoryCarrier
from tests.support.overlay import until
from tests.support.secure_streams import Stream
from tests.support.wire import ALICE, BOB

pytestmark = pytest.mark.attack("router-lies")

BOX = "rossec/1/home/" + 32 * "b"
VICTIM = "rossec/1/victim/" + 32 * "f"
MESSAGE = bytes(range(256)) * 256
Twist = Callable[[str, bytes], list[bytes]]


class Liar(MemoryCarrier):
    """What arrives instead of a frame is up to `twist`."""

    twist: Twist | None = None

    def _arrive(self, key: str, data: bytes) -> None:
        for frame in [data] if self.twist is None else self.twist(key, data):
            super()._arrive(key, frame)


class Bob:
    """Who is called: what he was told, how each connection ended, and who he answered."""

    def __init__(self) -> None:
        self.heard = bytearray()
        self.ends: list[type[BaseException]] = []
        self.answered = 0

    async def serve(self, stream: Stream) -> None:
        self.answered += 1
        try:
            while True:
                data = await stream.receive()
                self.heard += data
                await stream.send(data)
        except ChannelError as error:
            self.ends.append(type(error))
            raise


@asynccontextmanager
async def called(**options: Any) -> AsyncIterator[tuple[Liar, Bob]]:
    router, bob = Liar(), Bob()
    async with LinkListener(router, BOX, context(BOB, **options), bob.serve):
        yield router, bob


async def dialled(router: Liar) -> Stream:
    return await dial_link(router, BOX, "ward", context(ALICE))


async def echoed(stream: Stream, data: bytes) -> bytes:
    await stream.send(data)
    got = bytearray()
    while len(got) < len(data):
        got += await stream.receive()
    return bytes(got)


def changed(frame: bytes) -> bytes:
    """The frame with another last byte: it is not of a head."""
    return frame[:-1] + bytes((frame[-1] ^ 1,))


async def test_it_drops_repeats_and_reorders() -> None:
    dice = Random(19)
    late: dict[str, list[bytes]] = {}

    def twist(key: str, frame: bytes) -> list[bytes]:
        fate = dice.random()
        held = late.setdefault(key, [])
        if fate < 0.1:
            return []
        if fate < 0.2:
            held.append(frame)
            return []
        return [frame, frame, *(held.pop() for _ in range(len(held)))]

    async with called() as (router, bob):
        router.twist = twist
        async with await dialled(router) as stream:
            for part in range(8):
                data = bytes((part,)) * 40_000
                assert await echoed(stream, data) == data
        await until(lambda: bob.ends == [ChannelClosed])
        assert bytes(bob.heard) == b"".join(bytes((part,)) * 40_000 for part in range(8))


@pytest.mark.parametrize("to_bob", [True, False])
async def test_it_changes_bytes(to_bob: bool) -> None:
    async with called() as (router, bob):
        stream = await dialled(router)
        assert await echoed(stream, MESSAGE) == MESSAGE
        router.twist = lambda key, frame: [
            changed(frame) if kind_of(frame) == LinkFrameKind.DATA and (key == BOX) is to_bob else frame
        ]
        with pytest.raises(ChannelError):
            await echoed(stream, b"secret")
        stream.abort("the test ends")
        await until(lambda: bob.ends)
        assert bytes(bob.heard) in {MESSAGE, MESSAGE + b"secret"}
        assert (bytes(bob.heard) == MESSAGE) is to_bob


@pytest.mark.parametrize("kind", [LinkFrameKind.RESET, LinkFrameKind.END])
async def test_it_ends_a_link_and_both_see_that_something_is_missing(kind: LinkFrameKind) -> None:
    async with called() as (router, bob):
        stream = await dialled(router)
        assert await echoed(stream, MESSAGE) == MESSAGE
        frame = read(router.sent(LinkFrameKind.OPEN)[0][1])
        (answers,) = router.readers.keys() - {BOX}
        for key in (answers, BOX):
            sent = [read(data) for where, data in router.sent(LinkFrameKind.DATA) if where == key]
            end = max((each.offset + len(each.body) for each in sent), default=0)
            router.put(key, head(kind, frame.link, end if kind == LinkFrameKind.END else 0, 0, 0))
        with pytest.raises(ConnectionTruncated):
            await stream.receive()
        await until(lambda: bob.ends == [ConnectionTruncated])
        async with await dialled(router) as again:
            assert await echoed(again, b"again") == b"again"


async def test_it_plays_a_whole_link_again() -> None:
    async with called() as (router, bob):
        async with await dialled(router) as stream:
            assert await echoed(stream, b"open the door") == b"open the door"
        await until(lambda: bob.ends)
        recorded = [frame for key, frame in router.frames if key == BOX]
        for link in (recorded[0][1 : 1 + LINK_ID], bytes(LINK_ID)):
            for frame in recorded:
                router.put(BOX, frame[:1] + link + frame[1 + LINK_ID :])
        await asyncio.sleep(0.3)
        assert (bob.answered, bytes(bob.heard)) == (1, b"open the door")


async def test_it_gives_the_bytes_of_one_link_to_another() -> None:
    async with called() as (router, bob):
        one, two = await dialled(router), await dialled(router)
        links = [read(frame).link for _, frame in router.sent(LinkFrameKind.OPEN)]
        swap = dict(zip(links, reversed(links), strict=True))

        def twist(key: str, frame: bytes) -> list[bytes]:
            if key != BOX or kind_of(frame) != LinkFrameKind.DATA:
                return [frame]
            return [frame[:1] + swap[frame[1 : 1 + LINK_ID]] + frame[1 + LINK_ID :]]

        router.twist = twist
        await asyncio.gather(one.send(b"of one"), two.send(b"of two"))
        await until(lambda: len(router.sent(LinkFrameKind.PROBE)) > 1 or bob.ends)
        assert bob.heard == b""
        for stream in (one, two):
            stream.abort("the test ends")


def _forged_open(number: int, body: bytes) -> bytes:
    address = return_address(VICTIM, OPEN_SIZE - HEAD - len(body))
    return head(LinkFrameKind.OPEN, number.to_bytes(LINK_ID), 0, 0, 1 << 16) + address + body


async def test_it_forges_openings_that_are_answered_to_a_victim() -> None:
    """As anybody with an account who knows the inbox can."""
    impatient = ChannelLimits(handshake_seconds=1)
    async with called(limits=impatient) as (router, bob), await dialled(router) as honest:
        _, recorded = router.sent(LinkFrameKind.OPEN)[0]
        _, hello = split_return_address(read(recorded).body)
        forged = [_forged_open(number, bytes(hello)) for number in range(2000)]
        began = asyncio.get_running_loop().time()
        for frame in forged:
            router.put(BOX, frame)
            await asyncio.sleep(0)
        seconds = asyncio.get_running_loop().time() - began
        assert await echoed(honest, MESSAGE) == MESSAGE
        await asyncio.sleep(1.5)
        answers = [frame for key, frame in router.frames if key == VICTIM]
        answered = {frame[1 : 1 + LINK_ID] for frame in answers}
        assert 0 < len(answered) <= OPENS_PER_SECOND * (2 + seconds)
        assert max(map(len, answers)) > 200  # a message of the handshake, not only a refusal
        assert sum(map(len, answers)) <= 3 * sum(map(len, forged[: len(answered)]))
        assert bob.answered == 1
        assert await echoed(honest, MESSAGE) == MESSAGE


async def test_it_floods_an_inbox_with_garbage() -> None:
    dice = Random(7)
    async with called() as (router, bob):
        async with await dialled(router) as honest:
            link = read(router.sent(LinkFrameKind.OPEN)[0][1]).link
            other = inbox("ward", bytes(16))
            for number in range(3000):
                router.put(BOX, dice.randbytes(dice.randrange(200)))
                router.put(BOX, head(LinkFrameKind.PROBE, number.to_bytes(16), 0, 0, 0))
                router.put(other, head(LinkFrameKind.ACK, link, 0, 0, 0))
                if number % 100 == 0:
                    await asyncio.sleep(0)
            assert await echoed(honest, MESSAGE) == MESSAGE
            assert bob.answered == 1
        await until(lambda: bob.ends == [ChannelClosed])
