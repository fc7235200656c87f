"""Resources of a thing as topics and services; the thing is played."""

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest
from aiocoap.numbers import codes

from ca.encoding import encode
from grants.model import Right
from rossec.border.bridge import ThingBridge
from rossec.border.endpoint import CoapAnswer, CoapRequest, OnAnswer
from rossec.border.resources import read_links
from rossec.errors import ServiceFailed, ThingUnreachable
from rossec.host.runner import TaskSet
from tests.rossec.border.test_thing_node import thing_node
from tests.support.border import LAMP, TEMPERATURE
from tests.support.site import Site
from tests.support.witness import until

NOTHING = CoapAnswer(codes.CHANGED, None, b"")


class Played:
    """A thing."""

    def __init__(self) -> None:
        self.there = True
        self.asked: list[tuple[CoapRequest, OnAnswer]] = []
        self.cancelled: list[CoapRequest] = []
        self.tasks = TaskSet()

    def ask(self, request: CoapRequest, on_answer: OnAnswer) -> Callable[[], None] | None:
        if not self.there:
            return None
        self.asked.append((request, on_answer))
        return lambda: self.cancelled.append(request)

    def observed(self, answer: CoapAnswer | ThingUnreachable) -> None:
        """A state."""
        on_answer = [call for request, call in self.asked if request.observe][-1]
        on_answer(answer)

    async def request(self, code: Any) -> tuple[CoapRequest, OnAnswer]:
        """The newest request of a kind."""
        await until(lambda: any(request.code == code for request, _ in self.asked))
        return [found for found in self.asked if found[0].code == code][-1]


@pytest.fixture
async def bridge(site: Site) -> AsyncIterator[tuple[ThingBridge, Played]]:
    for right in (Right.PUBLISH, Right.SUBSCRIBE, Right.PROVIDE):
        site.grant(LAMP, right, f"{LAMP}/**")
    async with thing_node(site) as node:
        played = Played()
        made = ThingBridge(node, b"key", played.ask, played.tasks)
        await made.follow(read_links(TEMPERATURE.encode(), LAMP))
        yield made, played
        await played.tasks.close()
        await made.close("the test ends")


def state(value: float) -> CoapAnswer:
    return CoapAnswer(codes.CONTENT, 60, encode({"data": value}))


async def test_a_state_is_published(bridge: tuple[ThingBridge, Played], site: Site) -> None:
    made, played = bridge
    assert (made.offered, len(made.resources)) == (3, 3)
    site.subscribe("/heating", f"{LAMP}/temperature")
    async with site.node("/heating") as node:
        seen = await node.subscriber(f"{LAMP}/temperature", "std_msgs/Float32")
        await until(lambda: seen.links)
        played.observed(state(1.5))
        assert (await anext(aiter(seen))).data == 1.5
    assert made.received == 1


@pytest.mark.parametrize(
    "answer",
    [
        CoapAnswer(codes.CONTENT, 60, b"\xff"),
        CoapAnswer(codes.CONTENT, 65001, bytes(4)),
        CoapAnswer(codes.NOT_FOUND, None, b""),
    ],
)
async def test_what_is_no_state_is_dropped(bridge: tuple[ThingBridge, Played], answer: CoapAnswer) -> None:
    made, played = bridge
    played.observed(answer)
    assert (made.received, made.refused) == (0, 1)


async def test_what_sent_nothing_is_observed_anew(bridge: tuple[ThingBridge, Played]) -> None:
    made, played = bridge
    assert len(played.asked) == 1
    made.observe()
    assert len(played.asked) == 2
    assert len(played.cancelled) == 1
    played.observed(state(1.5))
    made.observe()
    assert len(played.asked) == 2
    played.observed(ThingUnreachable("it is out of reach"))
    made.lost()
    made.observe()
    assert len(played.asked) == 3


async def test_a_message_is_written(bridge: tuple[ThingBridge, Played], site: Site) -> None:
    made, played = bridge
    site.publish("/heating", f"{LAMP}/light")
    async with site.node("/heating") as node:
        light = await node.publisher(f"{LAMP}/light", "std_msgs/Bool")
        await light.wait_for_subscribers()
        light.publish(light.create(data=True))
        request, on_answer = await played.request(codes.PUT)
        assert (request.path, request.body) == (("l",), encode({"data": True}))
        on_answer(CoapAnswer(codes.NOT_FOUND, None, b""))
        await until(lambda: made.refused == 1)
        played.there = False
        light.publish(light.create(data=False))
        await until(lambda: made.refused == 2)


async def test_a_call_is_answered_or_fails(bridge: tuple[ThingBridge, Played], site: Site) -> None:
    _, played = bridge
    site.grant("/heating", Right.CALL, f"{LAMP}/switch")
    async with site.node("/heating") as node:
        call = node.client(f"{LAMP}/switch", "std_srvs/SetBool")
        for answer in (
            CoapAnswer(codes.CHANGED, 60, encode({"success": True, "message": "on"})),
            ThingUnreachable("it is out of reach"),
            CoapAnswer(codes.CHANGED, 60, b"\xff"),
        ):
            played.asked.clear()
            running = asyncio.gather(call(data=True), return_exceptions=True)
            request, on_answer = await played.request(codes.POST)
            assert request.body == encode({"data": True})
            on_answer(answer)
            (found,) = await running
            good = isinstance(answer, CoapAnswer) and answer.body != b"\xff"
            assert isinstance(found, ServiceFailed) is not good


async def test_a_thing_that_changes_what_it_has(bridge: tuple[ThingBridge, Played]) -> None:
    made, played = bridge
    await made.follow(read_links(b'</t>;rt="ros.pub";if="std_msgs/Float32";title="~new"', LAMP))
    assert [each.name for each in made.resources] == [f"{LAMP}/new"]
    assert made.offered == 1
    assert played.cancelled
    described = made.node.describe()
    assert described["getPublications"] == [[f"{LAMP}/new", "std_msgs/Float32"]]
    assert described["getSubscriptions"] == []


async def test_what_is_refused_is_offered_once_there_is_a_grant(
    bridge: tuple[ThingBridge, Played], site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    made, _ = bridge
    links = b'</t>;rt="ros.pub";if="std_msgs/Float32";title="/hall/temperature"'
    await made.follow(read_links(links, LAMP))
    assert made.offered == 0
    assert "/hall/temperature is not offered" in caplog.text
    site.publish(LAMP, "/hall/temperature")
    await made.update()
    assert made.offered == 1
    unknown = b'</t>;rt="ros.pub";if="no_msgs/Type";title="~x"'
    await made.follow(read_links(unknown, LAMP))
    assert made.offered == 0
