"""One served topic: demand here, one subscription at the origin, and what becomes of messages."""

import asyncio
import contextlib
from collections.abc import AsyncIterator

import pytest

from rossec.errors import AnswerRefused, ConnectionHeaderRefused, NodeShutdown
from rossec.gateway import rules
from rossec.gateway.gateway import ServedTopic
from rossec.gateway.rules import GatewayPhase, SourceCandidate, TypeChanged
from rossec.node.subscriber import RawSource
from rossec.participant.delivery_options import DeliveryOptions
from tests.rossec.gateway.doubles import (
    INT8,
    STRING,
    OriginSubscription,
    ServedPublisher,
    Topics,
    candidate,
    source,
)
from tests.support.witness import until


class Served:
    """A topic that is served, and its ends."""

    def __init__(self, given: SourceCandidate) -> None:
        self.topics = Topics()
        self.topic = ServedTopic(given, self.topics)
        self.task = asyncio.ensure_future(self.topic.run())

    @property
    def publisher(self) -> ServedPublisher:
        return self.topics.publishers[self.topic.candidate.served]

    async def begun(self) -> None:
        await until(lambda: self.topic.registered_at is not None)

    async def subscribed(self) -> OriginSubscription:
        await until(lambda: len(self.topics.open) == 1)
        return self.topics.open[0]

    async def ends(self) -> None:
        async with asyncio.timeout(10):
            await self.task


@contextlib.asynccontextmanager
async def served(given: SourceCandidate | None = None) -> AsyncIterator[Served]:
    made = Served(given or candidate())
    try:
        await made.begun()
        yield made
    finally:
        made.task.cancel()
        await asyncio.gather(made.task, return_exceptions=True)


@pytest.fixture(autouse=True)
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rules, "LINGER", 0.2)
    monkeypatch.setattr(rules, "FIRST_PAUSE", 0.05)


async def test_many_subscribers_here_are_one_at_the_origin() -> None:
    async with served() as it:
        first, second = it.publisher.subscribe(), it.publisher.subscribe()
        origin = await it.subscribed()
        robot = origin.connect(source())
        it.topic.received(robot, [b"one", b"two"])
        assert it.publisher.sent == [b"one", b"two"]
        assert (it.topic.messages, it.topic.octets) == (2, 6)
        assert (it.topic.subscribers, len(it.topic.sources)) == (2, 1)
        it.publisher.leave(first)
        it.publisher.leave(second)
        await until(lambda: it.topic.state.phase is GatewayPhase.LINGERING)
        assert origin.is_open
        await until(lambda: not origin.is_open)
        assert (it.topic.state.phase, len(it.topic.sources)) == (GatewayPhase.IDLE, 0)
        it.publisher.subscribe()
        assert (await it.subscribed()) is not origin
        assert len(it.topics.subscriptions) == 2


async def test_the_type_is_that_of_the_first_source() -> None:
    async with served() as it:
        it.publisher.subscribe()
        origin = await it.subscribed()
        before = it.publisher._known.is_set()
        origin.connect(source())
        assert (before, it.publisher._known.is_set()) == (False, True)
        with pytest.raises(ConnectionHeaderRefused, match="Int8"):
            origin.connect(source(INT8))
        assert not it.publisher.was_cut


async def test_another_gateway_is_no_source() -> None:
    async with served() as it:
        it.publisher.subscribe()
        origin = await it.subscribed()
        with pytest.raises(ConnectionHeaderRefused, match="no node of the origin"):
            origin.connect(RawSource("/gateway/attic", STRING, False))
        assert not it.publisher._known.is_set()


async def test_a_topic_whose_type_changes_is_closed() -> None:
    async with served() as it:
        publisher = it.publisher
        publisher.subscribe()
        origin = await it.subscribed()
        it.topic.disconnected(origin.connect(source()))
        with pytest.raises(TypeChanged):
            origin.connect(source(INT8))
        await it.ends()
        assert publisher.was_cut
        assert (it.topics.open, it.topics.publishers) == ([], {})


async def test_the_last_message_of_each_source_that_latches_is_kept_while_it_is_there() -> None:
    async with served() as it:
        it.publisher.subscribe()
        origin = await it.subscribed()
        one = origin.connect(source(latching=True))
        alone = it.publisher.latch
        two = origin.connect(source(latching=True))
        assert (alone, it.publisher.latch) == (True, False)
        for each, data in ((one, b"1"), (two, b"2"), (one, b"3")):
            it.topic.received(each, [data])
        assert it.publisher.kept == {one: b"3", two: b"2"}
        it.topic.disconnected(one)
        assert it.publisher.latch
        assert it.publisher.kept == {two: b"2"}


async def test_a_latched_topic_is_asked_again_without_a_rate() -> None:
    """A sender that thins out would keep the last message back for ever."""
    async with served(candidate(options=DeliveryOptions(rate=10, deflate=True))) as it:
        it.publisher.subscribe()
        first = await it.subscribed()
        assert first.options == DeliveryOptions(rate=10, deflate=True)
        with pytest.raises(ConnectionHeaderRefused, match="asked again"):
            first.connect(source(latching=True))
        it.topic.refused(ConnectionHeaderRefused("the topic is latched: asked again"))
        await until(lambda: not first.is_open and len(it.topics.open) == 1)
        again = it.topics.open[0]
        assert again.options == DeliveryOptions(newest=True, deflate=True)
        assert it.topic.problem == ""
        robot = again.connect(source(latching=True))
        it.topic.received(robot, [b"1", b"2", b"3"])
        assert it.publisher.sent == [b"1"]
        await until(lambda: it.publisher.sent == [b"1", b"3"])
        assert it.publisher.kept == {robot: b"3"}


async def test_a_topic_that_does_not_latch_is_thinned_out_by_its_sender() -> None:
    async with served(candidate(options=DeliveryOptions(rate=10))) as it:
        it.publisher.subscribe()
        origin = await it.subscribed()
        it.topic.received(origin.connect(source()), [b"1", b"2", b"3"])
        assert it.publisher.sent == [b"1", b"2", b"3"]


async def test_a_master_that_refuses_the_subscription_is_asked_again() -> None:
    async with served() as it:
        it.topics.refuses.add(it.topic.candidate.alias)
        it.publisher.subscribe()
        await until(lambda: it.topic.state.phase is GatewayPhase.PAUSED)
        assert it.topic.problem == it.publisher.problem
        assert "no right to subscribe" in it.topic.problem
        assert it.topics.subscriptions == []
        it.topics.refuses.clear()
        (await it.subscribed()).connect(source())
        assert it.topic.problem == it.publisher.problem == ""


async def test_a_refusal_by_a_publisher_of_the_origin_is_told() -> None:
    async with served() as it:
        it.publisher.subscribe()
        await it.subscribed()
        it.topic.refused(AnswerRefused("not for you"))
        it.topic.refused(TimeoutError())
        assert it.topic.problem == it.publisher.problem == "TimeoutError"


async def test_a_master_that_refuses_the_registration_ends_the_task() -> None:
    topics = Topics()
    topics.refuses.add("/gateway/ada/pose")
    topic = ServedTopic(candidate(), topics)
    with pytest.raises(AnswerRefused):
        await topic.run()
    assert (topic.registered_at, topic.subscribers) == (None, 0)


async def test_what_is_stopped_forwards_nothing_more_and_leaves_the_origin() -> None:
    async with served() as it:
        publisher = it.publisher
        publisher.subscribe()
        origin = await it.subscribed()
        robot = origin.connect(source())
        it.topic.stop()
        assert publisher.was_cut
        it.topic.received(robot, [b"late"])
        assert publisher.sent == []
        with pytest.raises(NodeShutdown):
            it.topic.connected(source())
        await it.ends()
        assert it.topics.open == []


async def test_a_crash_of_its_task_leaves_the_origin(monkeypatch: pytest.MonkeyPatch) -> None:
    async with served() as it:
        it.publisher.subscribe()
        origin = await it.subscribed()

        def crash(*_: object, **__: object) -> None:
            raise RuntimeError("a mistake")

        monkeypatch.setattr(it.topic.state, "step", crash)
        it.topic._wake.set()
        with pytest.raises(RuntimeError):
            await it.ends()
        assert not origin.is_open
        assert it.topics.publishers == {}
