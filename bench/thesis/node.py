"""A node of a measurement, told by lines: `python -m bench.thesis.node NAME ROLE [TOPIC]`.

The role is `publish` or `subscribe`.

A publisher is told a point and sends it on time, whatever becomes of the messages; it answers with
the time of each. A subscriber keeps the time at which each message was there in whole, and answers
with what it has when it is asked. The built-in node, so that everything is sealed as ever.
"""

import asyncio
import json
import sys
import time
from collections.abc import Awaitable, Callable
from typing import Any

from bench.thesis.talk import TOPIC, TYPE, Point, message, stamp
from rossec.node import Node, Publisher, Subscriber
from rossec.terminal import say_json

Act = Callable[[dict[str, Any]], Awaitable[object]]


async def send(publish: Callable[[bytes], None], number: int, point: Point) -> list[float]:
    """Send the messages of a point; when each was sent."""
    times, begin = list[float](), time.monotonic()
    for each in range(point.count):
        await asyncio.sleep(max(0.0, begin + each / point.rate - time.monotonic()))
        data = message(number, each, point.size)
        times.append(time.monotonic())
        publish(data)
    return times


def publishing(publisher: Publisher) -> Act:
    """What a publisher does when it is told."""

    async def act(order: dict[str, Any]) -> object:
        if "links" in order:
            while len(publisher.links) != order["links"]:  # noqa: ASYNC110 - nobody is told
                await asyncio.sleep(0.02)
            return None
        return await send(publisher.publish_bytes, order["number"], Point(**order["point"]))

    return act


class Arrivals:
    """When each message of the newest point arrived."""

    def __init__(self) -> None:
        self._times: dict[tuple[int, int], float] = {}

    def add(self, data: bytes) -> None:
        """Note a message that is there."""
        self._times.setdefault(stamp(data), time.monotonic())

    async def act(self, order: dict[str, Any]) -> object:
        """Those of a point, by number; nothing older is kept when it is the last question."""
        found = {n: at for (point, n), at in self._times.items() if point == order["number"]}
        if order.get("last"):
            self._times.clear()
        return found


async def subscribing(subscriber: Subscriber, arrivals: Arrivals) -> None:
    """Note everything that arrives."""
    async for data in subscriber.raw():
        arrivals.add(data)


def told(subscriber: Subscriber, arrivals: Arrivals) -> Act:
    """What a subscriber does when it is told."""

    async def act(order: dict[str, Any]) -> object:
        if "links" not in order:
            return await arrivals.act(order)
        while len(subscriber.links) != order["links"]:  # noqa: ASYNC110 - nobody is told
            await asyncio.sleep(0.02)
        return None

    return act


async def orders(act: Act, node: Node) -> None:
    """Carry out what is told, until the end of the input."""
    reader = asyncio.StreamReader(limit=1 << 22)
    protocol = asyncio.StreamReaderProtocol(reader)
    await asyncio.get_running_loop().connect_read_pipe(lambda: protocol, sys.stdin)
    tell("ready")
    while line := await reader.readline():
        order = json.loads(line)
        if "deliver" in order:  # a list that an authority has signed, in hexadecimal
            data = bytes.fromhex(order["list"])
            call = node._membership.session.call  # noqa: SLF001 - as tests.support.crew does
            tell(await call(order["deliver"], data))
        else:
            tell(await act(order))


def tell(value: object) -> None:
    """Answer."""
    say_json({"answer": value})
    sys.stdout.flush()


async def main(name: str, role: str, topic: str = TOPIC) -> None:
    """Be that node."""
    async with Node(name) as node:
        if role == "publish":
            await orders(publishing(await node.publisher(topic, TYPE)), node)
            return
        arrivals = Arrivals()
        subscriber = await node.subscriber(topic, TYPE, queue_size=10_000)
        async with asyncio.TaskGroup() as group:
            reading = group.create_task(subscribing(subscriber, arrivals))
            await orders(told(subscriber, arrivals), node)
            reading.cancel()


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
