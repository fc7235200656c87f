"""Delivery options of a subscriber as an attack: on the grant, on the header, on the receiver, on secrets."""

import asyncio
import contextlib
import struct
import zlib
from collections.abc import AsyncIterator, Callable
from typing import Any, Final

import pytest

from grants.model import Restriction, filter_rules
from rossec.channel.records import HEADER, TAG, Bytes, Frame
from rossec.demo.intruder import accept_any
from rossec.errors import ConnectionHeaderRefused, WireError
from rossec.net.aio import SecureStream, connect
from rossec.node import Subscriber
from rossec.participant import handshakes
from rossec.participant.delivery_options import deflated
from rossec.ros import tcpros
from rossec.ros.tcpros import MESSAGE_LIMIT, FrameReader
from tests.support.attacker import EVE, HOST, credentials, expect_refused, fields_for, send_header
from tests.support.contexts import unlimited
from tests.support.limited import SELDOM
from tests.support.site import Site
from tests.support.wire import joined
from tests.support.witness import TOPIC, Witness, until

OPTIONS: Final = {"rossec_rate": "9999.000", "rossec_newest": "1", "rossec_deflate": "1"}
TAKEN: Final = {key: value for key, value in OPTIONS.items() if key != "rossec_deflate"}
BOMB: Final = "/eve/bomb"
STRING: Final = "std_msgs/String"
TYPE: Final = "geometry_msgs/PoseStamped"


@contextlib.asynccontextmanager
async def subscribed(
    site: Site, witness: Witness, taken: dict[str, str], **options: str
) -> AsyncIterator[tuple[SecureStream[Any], FrameReader]]:
    """A connection of Eve's to the robot's topic with options, of which only `taken` are taken."""
    grants = [path.read_bytes() for path in site.enroll(EVE).path.glob("grants/*")]
    fields = fields_for(EVE, TOPIC, grants, **options)
    own = credentials(site)
    stream = await connect(HOST, witness.topic_port, unlimited(own, accept_any))
    try:
        await stream.send(tcpros.encode(fields))
        frames = FrameReader()
        while not (found := frames.feed(await stream.receive())):
            pass
        answer = tcpros.decode(found[0])
        assert "error" not in answer, answer
        assert {key: answer[key].decode() for key in options if key in answer} == taken
        yield stream, frames
    finally:
        stream.abort("heard enough")


async def heard(stream: SecureStream[Any], frames: FrameReader, seconds: float) -> list[bytes]:
    """The contents that arrive in so many seconds."""
    found: list[bytes] = []
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            while True:
                found += frames.feed(await stream.receive())
    return found


@pytest.mark.attack("option-beyond-grant")
async def test_no_wish_gives_more_than_the_grant(site: Site, witness: Witness) -> None:
    """Not a higher rate, not the messages that the rate left out, not what a filter took away."""
    rules = filter_rules({"header.frame_id": {"clear": True}})
    site.subscribe(EVE, TOPIC, Restriction(TYPE, (), rules, rate=SELDOM))
    async with subscribed(site, witness, TAKEN, **OPTIONS) as (stream, frames):
        before = witness.sent
        contents = await heard(stream, frames, 1)
        await witness.goes_on()
    assert len(contents) <= 1 < witness.sent - before
    for content in contents:
        assert b"living_room_map" not in content
    async with subscribed(site, witness, TAKEN, **OPTIONS) as (stream, frames):
        assert len(await heard(stream, frames, 1)) + len(contents) == 1, "the key's, as ever"
    await witness.goes_on()


@pytest.mark.attack("option-beyond-grant")
async def test_delivery_options_without_a_right_get_nothing(site: Site, witness: Witness) -> None:
    reply = await send_header(witness.topic_port, credentials(site), fields_for(EVE, TOPIC, [], **OPTIONS))
    assert set(reply.fields) == {"error"}
    assert reply.after == b""
    await witness.goes_on()


@pytest.mark.attack("option-malformed")
@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("rossec_rate", "0"),
        ("rossec_rate", "-1"),
        ("rossec_rate", "1e308"),
        ("rossec_rate", "nan"),
        ("rossec_rate", "9" * 40_000),
        ("rossec_rate", "\u0661"),
        ("rossec_newest", "yes"),
        ("rossec_deflate", ""),
    ],
)
async def test_a_malformed_wish_is_refused(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture, key: str, value: str
) -> None:
    grant = site.subscribe(EVE, TOPIC)
    fields = fields_for(EVE, TOPIC, [grant], **{key: value})
    reply = await send_header(witness.topic_port, credentials(site), fields)
    expect_refused(reply, caplog, ConnectionHeaderRefused, key)
    assert len(reply.error) < 200
    await witness.goes_on()


@pytest.mark.attack("deflated-length")
async def test_the_length_of_a_filtered_message_tells_nothing_on_the_network(
    site: Site, witness: Witness
) -> None:
    """Encryption leaves lengths visible, and deflated a coarse cell would be read from them."""
    rules = filter_rules({"header.frame_id": {"clear": True}})
    site.subscribe(EVE, TOPIC, Restriction(TYPE, (), rules))
    requested = {"rossec_deflate": "1", "rossec_newest": "1"}
    async with subscribed(site, witness, {"rossec_newest": "1"}, **requested) as (stream, frames):
        contents = await heard(stream, frames, 1)
    assert contents
    assert {len(content) for content in contents} == {struct.calcsize("<IIII7d")}
    await witness.goes_on()


@pytest.mark.attack("message-length")
async def test_the_length_of_a_padded_message_tells_nothing_on_the_network(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who watches the network sees the lengths of records, and no text: not even how long it is."""
    site.publish("/robot", TOPIC)
    site.subscribe("/viewer", TOPIC, Restriction(pad=256))
    seen: dict[Frame, set[int]] = {kind: set() for kind in Frame}
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        said = await robot.publisher(TOPIC, STRING)
        heard = aiter(await viewer.subscriber(TOPIC, STRING))
        await until(lambda: len(said.links) == 1)
        (link,) = said.links
        write = SecureStream.write

        def watched(stream: SecureStream[Any], record: Bytes) -> None:
            if stream is link.stream:
                seen[Frame(record[0] >> 4)].add(len(record))
            write(stream, record)

        monkeypatch.setattr(SecureStream, "write", watched)
        texts = ["yes", "no", "", "x" * 200]
        for text in texts:
            said.publish(said.create(data=text))
            assert (await anext(heard)).data == text
    assert seen[Frame.PADDED_END] == {HEADER + 256 + TAG}
    assert not seen[Frame.DATA] | seen[Frame.DATA_END]


@pytest.mark.attack("message-length")
@pytest.mark.parametrize("reuse", [False, True])
def test_the_pieces_of_a_padded_message_are_not_told_apart(reuse: bool) -> None:
    """What is filtered, and what comes at once, is sent in pieces, each in a record of its own."""
    lengths = set()
    for size in (20_000, 20_001, 30_000, 39_000):
        w = joined()
        w.left.core.pad_units(65_536)
        pieces = (b"length", bytes(size), b"between", bytes(20_000), b"end")
        records = [bytes(each) for each in w.left.core.seal_unit(*pieces, reuse=reuse)]
        lengths.add(tuple(map(len, records)))
        w.right.give(b"".join(records))
        assert w.right.units == [b"".join(pieces)]
    assert lengths == {(HEADER + 65_536 + TAG,)}


def raw(data: bytes) -> bytes:
    engine = zlib.compressobj(9, zlib.DEFLATED, -15)
    return engine.compress(data) + engine.flush()


def claim(size: int, data: bytes) -> bytes:
    return b"\1" + struct.pack("<I", size) + data


BOMBS: Final[dict[str, Callable[[], bytes]]] = {
    "more than a message may have": lambda: claim(MESSAGE_LIMIT + 1, raw(bytes(MESSAGE_LIMIT + 1))),
    "four gigabytes": lambda: claim(0xFFFFFFFF, raw(bytes(1 << 20))),
    "a size that is too small": lambda: claim(70_000, raw(bytes(MESSAGE_LIMIT))),
    "a size that is too large": lambda: claim(MESSAGE_LIMIT, raw(bytes(1000))),
    "no end": lambda: claim(1 << 20, raw(bytes(1 << 20))[:-2]),
    "more after the end": lambda: claim(1 << 20, raw(bytes(1 << 20)) + raw(bytes(1 << 20))),
    "no such data": lambda: claim(1 << 20, b"\xff" * 1000),
    "nothing": lambda: b"",
    "another mark": lambda: b"\2" + bytes(1000),
}


@contextlib.asynccontextmanager
async def bombed(
    site: Site, content: bytes, **options: Any
) -> AsyncIterator[tuple[Subscriber, SecureStream[Any]]]:
    """A node subscribes to Eve's topic and is sent `content`; with Eve's end of it."""
    site.publish(EVE, BOMB)
    site.subscribe("/hall", BOMB)
    async with site.node(EVE) as eve, site.node("/hall") as hall:
        publisher = await eve.publisher(BOMB, STRING)
        subscriber = await hall.subscriber(BOMB, STRING, **options)
        await publisher.wait_for_subscribers()
        (link,) = publisher.links
        link.stream.write_nowait(struct.pack("<I", len(content)) + content)
        yield subscriber, link.stream


@pytest.mark.attack("deflated-bomb")
@pytest.mark.parametrize("name", BOMBS)
async def test_a_bomb_ends_its_own_connection(site: Site, witness: Witness, name: str) -> None:
    async with bombed(site, BOMBS[name](), deflate=True) as (subscriber, _):
        await until(lambda: subscriber.refusals)
        assert isinstance(subscriber.refusals[0], WireError)
        assert subscriber.received == 0
    await witness.goes_on()


@pytest.mark.attack("deflated-bomb")
async def test_thousands_of_bombs_in_one_unit_disturb_nobody(site: Site, witness: Witness) -> None:
    """Each is as large as a message may be without a thread: together they are a gigabyte."""
    bomb = deflated([bytes(60_000)])
    unit = (struct.pack("<I", len(bomb)) + bomb) * 20_000
    first = deflated([b"first"])
    async with bombed(site, first, deflate=True, queue_size=3) as (subscriber, stream):
        await until(lambda: subscriber.received == 1)
        links = set(subscriber.links)
        sending = asyncio.ensure_future(stream.send(unit))
        await until(lambda: subscriber.received > 100)
        await witness.goes_on()
        assert subscriber.links == links
        assert len(subscriber._queue) <= 3
        sending.cancel()


@pytest.mark.attack("deflated-bomb")
async def test_a_publisher_may_not_deflate_unasked(
    site: Site, witness: Witness, monkeypatch: pytest.MonkeyPatch
) -> None:
    site.publish(EVE, BOMB)
    site.subscribe("/hall", BOMB)
    written = handshakes.publisher_header

    def forged(*arguments: Any, **options: Any) -> dict[str, bytes]:
        return {**written(*arguments, **options), "rossec_deflate": b"1"}

    monkeypatch.setattr(handshakes, "publisher_header", forged)
    async with site.node(EVE) as eve, site.node("/hall") as hall:
        await eve.publisher(BOMB, STRING)
        subscriber = await hall.subscriber(BOMB, STRING, rate=5)
        await until(lambda: subscriber.refusals)
        assert isinstance(subscriber.refusals[0], ConnectionHeaderRefused)
    await witness.goes_on()
