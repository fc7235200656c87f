"""A subscriber of the demo: reports every message it gets, and every refusal.

Run as `python -I -m rossec.demo.subscriber NAME TOPIC=TYPE...`; one JSON object a line on stdout.
"""

import asyncio
import sys
import time
from typing import Any

from rossec.node import Node, Subscriber
from rossec.terminal import say_json


async def main(name: str, topics: list[str]) -> None:
    async with Node(name) as node, asyncio.TaskGroup() as group:
        for topic, _, type_name in (item.partition("=") for item in topics):
            group.create_task(report(await node.subscriber(topic, type_name)))


async def report(subscriber: Subscriber) -> None:
    async for message in subscriber:
        say_json({"topic": subscriber.topic, "at": time.time(), **summary(message)})
        sys.stdout.flush()


def summary(message: Any) -> dict[str, object]:
    seen: dict[str, object] = {"seq": message.header.seq, "frame": message.header.frame_id}
    if hasattr(message, "pose"):
        position = message.pose.position
        seen["position"] = [position.x, position.y]
    if hasattr(message, "data"):
        seen["bytes"] = len(message.data)
    if hasattr(message, "temperature"):
        seen["temperature"] = message.temperature
    if hasattr(message, "ranges"):
        seen["ranges"] = len(message.ranges)
    return seen


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], sys.argv[2:]))
