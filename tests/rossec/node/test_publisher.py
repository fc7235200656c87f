import asyncio
import time
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest

from grants.errors import MessageRefused
from grants.filters import layout
from rossec.errors import ChannelClosed, ConfigurationError, NodeShutdown
from rossec.node.publisher import Publisher
from rossec.participant.authorized import memory_scope
from rossec.participant.delivery_options import DeliveryOptions, DeliveryQueue
from rossec.participant.handshakes import TopicEndpoint
from rossec.participant.message_types import message_type

STRING = message_type("std_msgs/String")


class Stream:
    """Collects what is sent; receives nothing until it is closed."""

    def __init__(self) -> None:
        self.peer = SimpleNamespace(name="/viewer", thumbprint=b"k", keys=(), not_after=time.time() + 99)
        self.sent: list[bytes] = []
        self.open = asyncio.Event()
        self.open.set()
        self.closed = asyncio.Event()

    async def send(self, *pieces: bytes) -> None:
        await self.open.wait()
        self.sent.append(b"".join(pieces))

    async def receive(self) -> bytes:
        await self.closed.wait()
        raise ChannelClosed("the peer closed the connection")


class Guard:
    """Filters messages with a function, and counts them."""

    def __init__(self, key: object = "k", filter_: Any = lambda message: [message]) -> None:
        self.key = key
        self.applied = 0
        self._filter = filter_

    memory = None

    def apply(self, message: Any, _now: int, _mark: object) -> Any:
        self.applied += 1
        return self._filter(message)


def no_keys(name: str) -> bytes:
    raise AssertionError(f"no filter needs the key {name}")


def publisher(**options: Any) -> Publisher:
    shape = layout.parse(STRING.name, STRING.definition)
    context: Any = SimpleNamespace(
        filter_key=no_keys,
        memory_scope=memory_scope("/robot"),
        connections=SimpleNamespace(track=lambda _: nullcontext()),
    )
    return Publisher(TopicEndpoint("/t", STRING), shape, context, **{"latch": False, **options})


def decision(seconds: int = 99) -> Any:
    return SimpleNamespace(expires=int(time.time()) + seconds, grant_ids=(), pad=0)


async def serve(topic: Publisher, stream: Any, guard: Any, seconds: int = 99) -> asyncio.Task[None]:
    task = asyncio.get_running_loop().create_task(topic.serve(stream, decision(seconds), guard, b""))
    await asyncio.sleep(0)
    return task


def text(data: str) -> bytes:
    return len(data.encode()).to_bytes(4, "little") + data.encode()


def framed(*texts: str) -> bytes:
    return b"".join((len(data) + 4).to_bytes(4, "little") + text(data) for data in texts)


async def settle() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


async def test_queued_messages_share_a_unit() -> None:
    topic, stream = publisher(), Stream()
    task = await serve(topic, stream, Guard())
    for data in ("one", "two"):
        topic.publish(topic.create(data=data))
    await settle()
    assert stream.sent[1:] == [framed("one", "two")]
    stream.closed.set()
    await task
    assert topic.links == {}


async def test_the_oldest_messages_of_a_slow_subscriber_are_dropped() -> None:
    topic, stream = publisher(queue_size=2), Stream()
    task = await serve(topic, stream, Guard())
    stream.open.clear()
    topic.publish_bytes(text("first"))
    await settle()
    for data in ("a", "b", "c"):
        topic.publish_bytes(text(data))
    (queue,) = topic.links.values()
    assert queue.dropped == 1
    stream.open.set()
    await settle()
    assert stream.sent[1:] == [framed("first"), framed("b", "c")]
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_subscribers_with_equal_filters_share_the_filtered_message() -> None:
    topic = publisher()
    guards = [Guard("same"), Guard("same"), Guard("other", lambda _: None)]
    tasks = [await serve(topic, Stream(), guard) for guard in guards]
    topic.publish_bytes(text("x"))
    assert sorted(guard.applied for guard in guards) == [0, 1, 1]
    assert sorted(queue.withheld for queue in topic.links.values()) == [0, 0, 1]
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def test_a_message_that_cannot_be_evaluated_is_withheld(caplog: pytest.LogCaptureFixture) -> None:
    def refuse(_: object) -> None:
        raise MessageRefused("not its layout")

    topic, stream = publisher(), Stream()
    task = await serve(topic, stream, Guard(filter_=refuse))
    for _ in range(50):
        topic.publish_bytes(b"not a string")
    await settle()
    assert stream.sent[1:] == []
    assert caplog.text.count("not its layout") == 1
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_an_expired_connection_receives_no_more_messages() -> None:
    topic, stream = publisher(), Stream()
    task = await serve(topic, stream, Guard(), seconds=0)
    topic.publish_bytes(text("late"))
    await settle()
    assert stream.sent[1:] == []
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


@pytest.mark.parametrize("withheld", [False, True])
async def test_a_latched_message_is_sent_to_new_subscribers(withheld: bool) -> None:
    topic, stream = publisher(latch=True), Stream()
    topic.publish_bytes(text("before"))
    guard = Guard(filter_=(lambda _: None) if withheld else (lambda message: [message]))
    task = await serve(topic, stream, guard)
    await settle()
    assert stream.sent[1:] == ([] if withheld else [framed("before")])
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_wait_for_subscribers_returns_when_they_are_connected() -> None:
    topic = publisher()
    waiting = asyncio.get_running_loop().create_task(topic.wait_for_subscribers(2))
    tasks = [await serve(topic, Stream(), Guard())]
    await settle()
    assert not waiting.done()
    tasks.append(await serve(topic, Stream(), Guard()))
    await asyncio.wait_for(waiting, 1)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def test_a_connection_is_registered_before_its_answer_is_sent() -> None:
    topic, stream = publisher(), Stream()
    stream.open.clear()
    task = await serve(topic, stream, Guard())
    assert len(topic.links) == 1
    topic.publish_bytes(text("early"))
    stream.open.set()
    await settle()
    assert stream.sent == [b"", framed("early")]
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_a_buffer_that_changes_later_is_sent_as_it_was_checked() -> None:
    topic, stream = publisher(latch=True), Stream()
    task = await serve(topic, stream, Guard())
    buffer = bytearray(text("before"))
    topic.publish_bytes(memoryview(buffer))
    buffer[4:] = b"forged"
    await settle()
    assert stream.sent[1:] == [framed("before")]
    late = Stream()
    other = await serve(topic, late, Guard())
    await settle()
    assert late.sent[1:] == [framed("before")]
    for running in (task, other):
        running.cancel()
    await asyncio.gather(task, other, return_exceptions=True)


async def test_a_closed_node_publishes_nothing() -> None:
    topic = publisher()
    topic.close()
    with pytest.raises(NodeShutdown, match="the node is closed"):
        topic.publish(topic.create(data="late"))


@pytest.mark.parametrize("size", [0, -1])
async def test_a_queue_size_below_one_is_refused(size: int) -> None:
    with pytest.raises(ConfigurationError, match="a queue of"):
        publisher(queue_size=size)


async def test_a_subscriber_with_wishes_gets_them_after_its_guard() -> None:
    """What the guard takes away uses up no rate, and both see every message."""
    topic, plain, wishing = publisher(), Stream(), Stream()
    guard = Guard(filter_=lambda message: None if b"secret" in bytes(message) else [message])
    tasks = [await serve(topic, plain, guard)]
    tasks.append(
        asyncio.get_running_loop().create_task(
            topic.serve(wishing, decision(), guard, b"", DeliveryOptions(0.001))  # type: ignore[arg-type]
        )
    )
    await asyncio.sleep(0)
    for data in ("secret", "secret", "one", "secret", "two", "three"):
        topic.publish_bytes(text(data))
    await settle()
    assert b"".join(plain.sent[1:]) == framed("one", "two", "three")
    assert b"".join(wishing.sent[1:]) == framed("one", "two")
    (queue,) = (queue for queue in topic.links.values() if isinstance(queue, DeliveryQueue))
    assert (queue.withheld, queue.thinned) == (3, 1)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
