"""The process of the preview, the node `/console`: `python -I -m rossec.console.preview`.

It is enrolled and granted like any other node, and shown among the receivers. It writes nothing to a disk,
and ends with the connection.
"""

import asyncio
import logging
import os
import socket
import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import Final

from ca.errors import HintedError
from grants.model import Right
from rossec import clock
from rossec.console.samples import MAX_DATA, MAX_TOPICS, PreviewMessage, write_preview
from rossec.discovery import discover_master
from rossec.errors import AnswerRefused, MessageError
from rossec.host.runner import TaskSet, until_first_ends
from rossec.host.sandbox import protect_memory
from rossec.node import Node, Subscriber

NAME: Final = "/console"
PERIOD: Final = 3.0  # seconds between two looks for topics
PER_SECOND: Final = 10  # messages of one topic
_RETRY: Final = 10.0
_log = logging.getLogger("rossec.console")


class PreviewReceiver:
    def __init__(
        self, writer: asyncio.StreamWriter, environ: Mapping[str, str], period: float = PERIOD
    ) -> None:
        self._writer = writer
        self._environ = environ
        self._period = period
        self._subscribers: dict[str, Subscriber] = {}

    async def run(self) -> None:
        while True:
            try:
                environ = await discover_master(self._environ, NAME)
                async with Node(NAME, environ=environ) as node:
                    tasks = TaskSet()
                    try:
                        while True:
                            await self._look(node, tasks)
                            await asyncio.sleep(self._period)
                    finally:
                        await tasks.close()
            except (HintedError, OSError) as error:
                _log.warning("the preview does not run now: %s", error)
            self._subscribers.clear()
            await asyncio.sleep(_RETRY)

    async def _look(self, node: Node, tasks: TaskSet) -> None:
        def may_see(topic: str) -> bool:
            return node.access.holds(Right.SUBSCRIBE, topic, clock.now())

        # Grants that come or end take effect within seconds: asked again each time.
        found = await node.topic_types()
        for topic in tuple(self._subscribers):
            if not may_see(topic):
                await self._subscribers.pop(topic).close()
        for topic, kind in sorted(found.items()):
            if topic in self._subscribers or len(self._subscribers) >= MAX_TOPICS or not may_see(topic):
                continue
            with suppress(AnswerRefused, MessageError):  # ended since; unknown type
                self._subscribers[topic] = await node.subscriber(topic, kind)
                tasks.spawn(self._pass_on(self._subscribers[topic], kind), f"preview of {topic}")

    async def _pass_on(self, subscriber: Subscriber, kind: str) -> None:
        next_at = 0.0
        async for data in subscriber.raw():
            at = clock.time()
            if at < next_at or len(data) > MAX_DATA:
                continue
            next_at = at + 1 / PER_SECOND
            self._writer.write(write_preview(PreviewMessage(subscriber.topic, kind, at, data)))
            await self._writer.drain()


async def receive(sock: socket.socket, environ: Mapping[str, str]) -> None:
    reader, writer = await asyncio.open_connection(sock=sock)
    try:
        await until_first_ends(PreviewReceiver(writer, environ).run(), reader.read(1))
    except ConnectionError:
        return
    finally:
        writer.transport.abort()


def main(arguments: list[str]) -> None:
    logging.basicConfig(level=logging.WARNING)
    protect_memory()
    asyncio.run(receive(socket.socket(fileno=int(arguments[0])), os.environ))


if __name__ == "__main__":
    main(sys.argv[1:])
