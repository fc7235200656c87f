"""Attackers on the network of constrained things: without a key, or with what they recorded."""

import asyncio
import contextlib
import secrets
import socket
from collections.abc import AsyncIterator, Callable, Iterator

import lakers
import pytest
from aiocoap import Message
from aiocoap.numbers import codes
from aiocoap.oscore import NotAProtectedMessage

from ca.encoding import encode
from rossec.border import messages
from rossec.border.handshakes import MAX_PENDING
from rossec.border.messages import OscoreContext
from rossec.errors import DatagramRefused
from rossec.host.runner import TaskSet
from tests.support.border import LAMP, BorderSite
from tests.support.rawthing import EDHOC, RawThing
from tests.support.site import Site

DEADLINE = 20.0
FLOOD = 1500
LINKS = b'</t>;rt="ros.pub";if="std_msgs/Float32";title="~temperature";ct=60'


@pytest.fixture
async def border(site: Site) -> AsyncIterator[BorderSite]:
    async with BorderSite(site).running() as found:
        yield found


@contextlib.asynccontextmanager
async def raw(border: BorderSite, name: str = LAMP, kid: bytes = b"\x2c") -> AsyncIterator[RawThing]:
    """A thing that is stated; `name` empty: one that is not."""
    thing = RawThing(border.address, border.key.credential, LINKS, kid, encode({"data": 1.5}))
    if name:
        border.state(name, thing.credential)
        border.allow(name)
    await thing.start()
    try:
        yield thing
    finally:
        thing.close()


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(DEADLINE):
        while not condition():  # noqa: ASYNC110 - a state of others, without an event
            await asyncio.sleep(0.02)


def message_1() -> bytes:
    """A handshake's first message, as any thing sends it."""
    first = bytes(lakers.EdhocInitiator().prepare_message_1(b"\x05", None))
    message = Message(code=codes.POST, uri_path=EDHOC, payload=b"\xf5" + first)
    message.mtype, message.mid = messages.CON, secrets.randbelow(1 << 16)
    message.token = secrets.token_bytes(4)
    return messages.write(message)


@contextlib.contextmanager
def sockets(border: BorderSite, many: int) -> Iterator[list[socket.socket]]:
    """Attackers with so many addresses."""
    with contextlib.ExitStack() as stack:
        made = [stack.enter_context(socket.socket(socket.AF_INET6, socket.SOCK_DGRAM)) for _ in range(many)]
        for each in made:
            each.setblocking(False)
            each.connect(border.address)
        yield made


@pytest.mark.attack("thing-replay")
async def test_recorded_datagrams_change_nothing(border: BorderSite) -> None:
    async with raw(border) as thing:
        assert await thing.register()
        await until(lambda: thing._observers)
        await until(lambda: border.router.bridges[LAMP].received == 1)
        thing.notify(encode({"data": 2.5}))
        await until(lambda: border.router.bridges[LAMP].received == 2)
        with sockets(border, 1) as (eve,):
            for data in thing.sent * 2:
                eve.send(data)
        for data in tuple(thing.sent):  # from the thing's own address as well
            thing.send(data)
        assert await thing.request(codes.POST, ("rd",)) == codes.CHANGED
        counts = border.router.server.endpoint.counts
        assert counts.handshakes == 1
        assert border.router.bridges[LAMP].received == 2


@pytest.mark.attack("thing-replay")
async def test_recorded_derivations_of_a_secret_change_nothing(border: BorderSite) -> None:
    thing = border.secret_thing()
    recorded: list[tuple[bytes, tuple[object, ...]]] = []
    endpoint = border.router.server.endpoint
    receive = endpoint.receive

    def record(data: bytes, address: tuple[object, ...], now: float) -> None:
        recorded.append((data, address))
        receive(data, address, now)

    endpoint.receive = record  # type: ignore[method-assign]
    async with thing:
        assert (await thing.register()).dotted == "2.04"
        before = endpoint.conversations.of(LAMP)
        for data, _ in tuple(recorded):
            with sockets(border, 1) as (eve,):
                eve.send(data)
                await asyncio.sleep(0.05)
        assert endpoint.conversations.of(LAMP) is before
        assert endpoint.counts.derivations == 1
        assert (await thing.register()).dotted == "2.04"


@pytest.mark.attack("thing-forgery")
async def test_a_thing_that_is_not_stated_is_refused_as_one_with_a_wrong_key(border: BorderSite) -> None:
    """The same answer, to the byte, whether the kid is that of a thing here or not."""
    async with raw(border), raw(border, "", b"\x2d") as unknown, raw(border, "", b"\x2c") as wrong:
        answers = []
        for thing in (unknown, wrong):
            message_3 = await thing.handshake()
            answer = await thing.ask(thing.protected(codes.POST, ("rd",), message_3))
            answers.append((answer.code, bytes(answer.payload), answer.opt.encode()))
        assert answers == [(codes.UNAUTHORIZED, b"", b"")] * 2
    assert not border.router.bridges


@pytest.mark.attack("thing-forgery")
async def test_a_kid_of_a_thing_is_not_enough(border: BorderSite) -> None:
    async with raw(border) as thing, raw(border, "", b"\x2d") as eve:
        assert await thing.register()
        kid = thing.context.sender_id
        eve.context = OscoreContext(secrets.token_bytes(16), b"", kid, thing.context.recipient_id)
        for _ in range(20):
            answer = await eve.ask(eve.protected(codes.DELETE, ("rd",)))
            assert (answer.code, answer.opt.oscore) == (codes.UNAUTHORIZED, None)
        assert await thing.request(codes.POST, ("rd",)) == codes.CHANGED


@pytest.mark.attack("thing-forgery")
async def test_a_statement_for_another_router_is_of_no_use(border: BorderSite, site: Site) -> None:
    other = BorderSite(site, "/attic")
    async with other.running(), raw(border) as thing:
        assert await thing.register()
        thing.border, thing.peer = other.address, other.key.credential
        thing.close()
        await thing.start()
        with pytest.raises((DatagramRefused, TimeoutError)):
            await thing.register()
        assert not other.router.bridges


@pytest.mark.attack("thing-flood")
async def test_a_flood_of_handshakes_is_bounded_and_spares_the_others(border: BorderSite) -> None:
    endpoint = border.router.server.endpoint
    fan = border.secret_thing("/things/fan")
    async with raw(border) as thing, raw(border, "/things/new", b"\x2d") as late:
        assert await thing.register()
        with sockets(border, 40) as many:
            flood = TaskSet()
            flood.spawn(_flood(many))
            try:
                await asyncio.sleep(0.3)
                for _ in range(5):
                    assert await thing.request(codes.GET, ("x",)) == codes.NOT_FOUND
                    await asyncio.sleep(0.1)
                async with fan, asyncio.timeout(DEADLINE):
                    assert (await fan.register()).dotted == "2.04"
                assert len(endpoint._handshakes) <= MAX_PENDING
                assert endpoint.counts.over_budget
            finally:
                await flood.close()
        await asyncio.sleep(1.2)  # the budget of a second
        assert await late.register()


async def _flood(many: list[socket.socket]) -> None:
    """Handshakes without an end, from many ports."""
    number = 0
    while True:
        for _ in range(20):
            number += 1
            with contextlib.suppress(BlockingIOError):
                many[number % len(many)].send(message_1())
        await asyncio.sleep(0.01)


@pytest.mark.attack("thing-flood")
async def test_a_flood_of_datagrams_and_resets_delays_no_call_of_a_thing(border: BorderSite) -> None:
    """With its kid, its address, and all message IDs; this thing repeats nothing."""
    async with raw(border) as thing:
        assert await thing.register()
        endpoint, kid = border.router.server.endpoint, thing.context.sender_id
        found = endpoint.conversations.of(LAMP)
        assert found is not None
        eve = OscoreContext(secrets.token_bytes(16), b"", kid, b"")
        sealed, _ = eve.seal(Message(code=codes.POST, uri_path=("rd",)))
        sealed.mtype, sealed.mid, sealed.token = messages.NON, 1, b"t"
        forged = messages.write(sealed)
        with sockets(border, 8) as many:
            flood = TaskSet()
            flood.spawn(_flood_of(many, forged))
            try:
                for number in range(20):
                    assert await thing.request(codes.GET, ("x",)) == codes.NOT_FOUND
                    for mid in range(number * 3277, (number + 1) * 3277):
                        endpoint.receive(messages.empty(messages.RST, mid & 0xFFFF), found.address, 0.0)
                assert endpoint.counts.refused + border.router.server.lost > 1000  # of the flood
            finally:
                await flood.close()


async def _flood_of(many: list[socket.socket], data: bytes) -> None:
    while True:
        for each in many * 20:
            with contextlib.suppress(BlockingIOError):
                each.send(data)
        await asyncio.sleep(0)


@pytest.mark.attack("thing-flood")
async def test_a_flood_with_the_kid_of_a_secret_does_not_keep_its_thing_out(border: BorderSite) -> None:
    fan = border.secret_thing("/things/fan")
    eve = OscoreContext(secrets.token_bytes(16), b"", fan.kid, b"")
    async with fan:
        with sockets(border, 4) as many:
            for number in range(FLOOD):
                sealed, _ = eve.seal(Message(code=codes.POST, uri_path=("rd",)))
                kid_context = encode(secrets.token_bytes(8)) if number % 2 else b""
                if kid_context:
                    from rossec.border.messages import name_context

                    name_context(sealed, kid_context)
                sealed.mtype, sealed.mid, sealed.token = messages.CON, number, b"t"
                with contextlib.suppress(BlockingIOError):
                    many[number % 4].send(messages.write(sealed))
            async with asyncio.timeout(DEADLINE):
                assert (await fan.register()).dotted == "2.04"
        server = border.router.server
        assert server.endpoint.counts.over_budget + server.lost > FLOOD / 2


@pytest.mark.attack("thing-datagrams")
async def test_datagrams_of_any_bytes_are_refused_without_harm(border: BorderSite) -> None:
    async with raw(border) as thing:
        assert await thing.register()
        recorded = [data for data in thing.sent if len(data) > 20]
        with sockets(border, 2) as (eve, other):
            for data in recorded:
                for end in range(len(data)):
                    eve.send(data[:end])
                    flipped = bytearray(data)
                    flipped[end] ^= 0xFF
                    other.send(flipped)
                    if end % 16 == 0:
                        await asyncio.sleep(0)
            for size in range(0, 1600, 50):
                eve.send(secrets.token_bytes(size))
                other.send(b"\x40\x02\x00\x01\xff" + secrets.token_bytes(size))
        await asyncio.sleep(0.3)
        assert await thing.request(codes.POST, ("rd",)) == codes.CHANGED
        assert border.router.server.endpoint.counts.handshakes == 1


@pytest.mark.attack("thing-datagrams")
async def test_the_kid_of_a_refused_thing_is_told_to_nobody(border: BorderSite) -> None:
    """aiocoap's client sees an answer without protection, and nothing in it."""
    thing = border.thing()
    await border.revoke(border.roster_statement(LAMP).id)
    async with thing:
        with pytest.raises(NotAProtectedMessage):
            await thing.register()
