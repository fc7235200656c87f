"""A thing that is stated, and whose owner attacks: it exceeds its limits, lies, uses old names."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable

import pytest
from aiocoap.numbers import codes

from ca.encoding import encode
from grants.model import Right
from rossec.border.constrained_node import MasterVisits
from rossec.border.conversations import MAX_BODY, MESSAGE_BURST
from rossec.errors import DatagramRefused
from tests.support.border import LAMP, BorderSite
from tests.support.constrained import Value
from tests.support.rawthing import RawThing
from tests.support.site import Site

DEADLINE = 20.0
PUBLISHED = b'</t>;rt="ros.pub";if="std_msgs/Float32";title="~temperature";ct=60'
EVE = "/things/eve"


@pytest.fixture
async def border(site: Site) -> AsyncIterator[BorderSite]:
    async with BorderSite(site).running() as found:
        yield found


@contextlib.asynccontextmanager
async def raw(
    border: BorderSite, name: str = EVE, kid: bytes = b"\x2d", links: bytes = PUBLISHED
) -> AsyncIterator[RawThing]:
    thing = RawThing(border.address, border.key.credential, links, kid, encode({"data": 1.5}))
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


@pytest.mark.attack("thing-excess")
async def test_more_notifications_than_its_rate_are_dropped(border: BorderSite) -> None:
    async with raw(border) as eve, raw(border, LAMP, b"\x2c") as lamp:
        assert await eve.register()
        assert await lamp.register()
        await until(lambda: eve._observers and lamp._observers)
        for number in range(400):
            eve.notify(encode({"data": float(number)}))
            if number % 20 == 0:
                await asyncio.sleep(0)
        before = border.router.bridges[LAMP].received
        lamp.notify(encode({"data": 7.5}))
        await until(lambda: border.router.bridges[LAMP].received > before)
        assert border.router.bridges[EVE].received < MESSAGE_BURST + 50
        conversation = border.router.server.endpoint.conversations.of(EVE)
        assert conversation is not None
        assert conversation.quota.dropped > 200


@pytest.mark.attack("thing-excess")
@pytest.mark.parametrize(
    "body",
    [
        b"\xff" * 900,  # no CBOR
        b"\x9f" * 800,  # indefinite arrays in each other
        b"\x81" * 900,  # arrays in each other
        b"\xbb" + b"\xff" * 8,  # a map of 2^64 entries
        b"\x5b\x00\x00\x00\xff\xff\xff\xff\xff",  # a byte string of 1 TB
        b"\xd8\x23\x60",  # a tag that would compile a regular expression
        encode({"data": "text"}),
        encode({"data": 1.5, "more": 1}),
        encode({}),
        encode([1.5]),
        b"",
    ],
)
async def test_bodies_that_are_no_message_are_dropped(border: BorderSite, body: bytes) -> None:
    async with raw(border) as eve:
        assert await eve.register()
        await until(lambda: eve._observers)
        await until(lambda: border.router.bridges[EVE].received == 1)
        eve.notify(body)
        await until(lambda: border.router.bridges[EVE].refused == 1)
        eve.notify(encode({"data": 2.5}))
        await until(lambda: border.router.bridges[EVE].received == 2)


@pytest.mark.attack("thing-excess")
async def test_a_state_of_too_many_blocks_is_given_up(border: BorderSite) -> None:
    links = '</t>;rt="ros.pub";if="std_msgs/String";title="~text";ct=60'
    eve = border.thing(EVE, links, b"\x2d")
    border.allow(EVE)
    value = eve.add("/t", Value(60, encode({"data": "fits"})))
    async with eve:
        await eve.register()
        await until(lambda: EVE in border.router.bridges and border.router.bridges[EVE].received)
        value.set(b"x" * (MAX_BODY + 4096))
        await asyncio.sleep(1)
        value.set(encode({"data": "fits again"}))
        await until(lambda: border.router.bridges[EVE].received == 2)
        assert len(border.router.server.endpoint.requests) <= 2


@pytest.mark.attack("thing-excess")
@pytest.mark.parametrize(
    "links",
    [
        b",".join(
            b'</t%d>;rt="ros.pub";if="std_msgs/Float32";title="~t%d"' % (each, each) for each in range(65)
        ),
        b"<" * 7000,
        b"x" * 9000,
        b'</t>;rt="ros.pub";if="std_msgs/Float32";title="~a/../b"',
        b'</t>;rt="ros.pub";if="../../etc/passwd";title="~a"',
        b",".join(b'</%s>;rt="ros.pub";if="std_msgs/Float32";title="~a"' % each for each in (b"t", b"u")),
    ],
)
async def test_lists_of_resources_that_are_too_much_or_malformed(
    border: BorderSite, links: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    eve = border.thing(EVE, links.decode(), b"\x2d")
    border.allow(EVE)
    async with eve:
        assert (await eve.register()).dotted == "2.04"
        await until(lambda: f"{EVE}: " in caplog.text)
        bridge = border.router.bridges.get(EVE)
        assert bridge is None or bridge.offered == 0


@pytest.mark.attack("thing-names")
async def test_the_name_of_another_needs_a_grant_of_it(border: BorderSite) -> None:
    """A thing may say that it has any name; its node has the rights of its own grants."""
    links = (
        f'</t>;rt="ros.pub";if="std_msgs/Float32";title="{LAMP}/temperature";ct=60,'
        f'</s>;rt="ros.srv";if="std_srvs/SetBool";title="{LAMP}/switch";ct=60,'
        '</r>;rt="ros.sub";if="std_msgs/Bool";title="/doctor/orders";ct=60,'
        '</m>;rt="ros.srv";if="std_srvs/SetBool";title="/remote/hospital/door";ct=60'
    )
    border.site.subscribe("/heating", f"{LAMP}/temperature")
    async with raw(border, links=links.encode()) as eve, border.site.node("/heating") as node:
        border.site.grant(EVE, Right.PROVIDE, f"{EVE}/**")
        seen = await node.subscriber(f"{LAMP}/temperature", "std_msgs/Float32")
        assert await eve.register()
        await until(lambda: EVE in border.router.bridges)
        await until(lambda: border.router.bridges[EVE].resources)
        await asyncio.sleep(0.5)
        assert border.router.bridges[EVE].offered == 0
        assert not eve._observers
        assert not seen.links


@pytest.mark.attack("thing-names")
async def test_a_thing_that_was_renamed_is_not_served_under_its_old_name(border: BorderSite) -> None:
    async with raw(border) as eve:
        assert await eve.register()
        await until(lambda: EVE in border.router.bridges)
        await border.revoke(border.roster_statement(EVE).id)
        border.state("/things/renamed", eve.credential)
        await until(lambda: EVE not in border.router.bridges)
        assert await eve.register()
        await until(lambda: "/things/renamed" in border.router.bridges)
        assert EVE not in border.router.bridges


@pytest.mark.attack("revoked-thing")
@pytest.mark.parametrize("what", ["statement", "key"])
async def test_a_revoked_thing_is_cut_and_does_not_return(border: BorderSite, what: str) -> None:
    border.site.subscribe("/heating", f"{EVE}/temperature")
    async with raw(border) as eve, border.site.node("/heating") as node:
        seen = await node.subscriber(f"{EVE}/temperature", "std_msgs/Float32")
        assert await eve.register()
        await until(lambda: seen.links)
        statement = border.roster_statement(EVE)
        await border.revoke(statement.id if what == "statement" else statement.credential.thumbprint)
        assert EVE not in border.router.bridges
        await until(lambda: not seen.links)
        received = seen.received
        eve.notify(encode({"data": 3.5}))
        answer = await eve.ask(eve.protected(codes.POST, ("rd",)))
        assert (answer.code, answer.opt.oscore) == (codes.UNAUTHORIZED, None)
        with pytest.raises(DatagramRefused):
            await eve.register()
        assert seen.received == received


@pytest.mark.attack("revoked-thing")
async def test_a_statement_that_expired_or_was_forgotten_ends_the_thing(border: BorderSite) -> None:
    async with raw(border) as eve, raw(border, LAMP, b"\x2c") as lamp:
        assert await eve.register()
        assert await lamp.register()
        await until(lambda: len(border.router.bridges) == 2)
        border.files.forget(LAMP)
        now = border.site.now()
        border.state(EVE, eve.credential, not_before=now - 1, expires=now + 2)
        await until(lambda: not border.router.bridges)


@pytest.mark.attack("thing-views")
async def test_a_view_of_a_thing_is_what_the_grant_says(border: BorderSite) -> None:
    """The doctor reads every value, the heating what is rounded: filtered at the border router."""
    from grants.model import Restriction, filter_rules

    rounded = Restriction(type="std_msgs/Float32", filters=filter_rules({"data": {"round": {"step": 5.0}}}))
    topic = f"{EVE}/temperature"
    border.site.subscribe("/doctor", topic)
    border.site.subscribe("/heating", topic, rounded)
    async with (
        raw(border) as eve,
        border.site.node("/doctor") as doctor,
        border.site.node("/heating") as heating,
    ):
        views = [await each.subscriber(topic, "std_msgs/Float32") for each in (doctor, heating)]
        assert await eve.register()
        await until(lambda: all(view.links for view in views))
        eve.notify(encode({"data": 21.5}))
        async with asyncio.timeout(DEADLINE):
            full, coarse = [(await anext(aiter(view))).data for view in views]
        assert (full, coarse % 5.0) == (21.5, 0.0)


@pytest.mark.attack("thing-excess")
async def test_a_thing_that_registers_again_and_again_is_asked_once(border: BorderSite) -> None:
    """It does not say what it has; what waits for that does not grow."""
    async with raw(border) as eve:
        served = eve._serve
        eve._serve = lambda message: None  # type: ignore[method-assign]
        assert await eve.register()
        for _ in range(12):
            assert await eve.request(codes.POST, ("rd",)) == codes.CHANGED
        assert len(border.router.server.endpoint.requests) == 1
        tasks = [each.get_name() for each in asyncio.all_tasks()]
        assert tasks.count(f"{EVE}: registered") == 1
        eve._serve = served  # type: ignore[method-assign]
        assert await eve.register()
        await until(lambda: EVE in border.router.bridges and border.router.bridges[EVE].received)
        await until(lambda: not border.router._attending)


@pytest.mark.attack("revoked-thing")
async def test_a_thing_that_is_revoked_while_it_is_offered_registers_nothing(
    border: BorderSite, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The master answers slowly: what was under way ends with the thing, in either order."""
    call = MasterVisits.call

    async def slow(self: MasterVisits, method: str, *params: object) -> object:
        await asyncio.sleep(0.05)
        return await call(self, method, *params)

    monkeypatch.setattr(MasterVisits, "call", slow)
    links = b",".join(
        b'</t%d>;rt="ros.pub";if="std_msgs/Float32";title="~t%d";ct=60' % (each, each) for each in range(14)
    )
    async with raw(border, links=links) as eve:
        assert await eve.register()
        await until(lambda: EVE in border.router.bridges and border.router.bridges[EVE].offered)
        bridge = border.router.bridges[EVE]
        assert bridge.offered < 14
        await border.revoke(border.roster_statement(EVE).id)
        await until(lambda: not len(border.router._tasks))
        assert bridge.offered < 14
        state = await border.router.node._membership.session.call("getSystemState")
        assert EVE not in str(state)
