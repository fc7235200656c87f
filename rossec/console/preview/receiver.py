"""The process of the preview, the node `/console`: `python -I -m rossec.console.preview.receiver`.

It is enrolled and granted like any other node, and shown among the receivers. It subscribes to what
it may receive and passes it on, a few messages of each topic a second; it writes none of it to a
disk. Grants that come or end take effect within seconds. It ends with the connection.
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
from rossec.console.preview import frames
from rossec.console.preview.memory import MAX_TOPICS, PreviewMessage
from rossec.discovery.choose import discover_master
from rossec.errors import AnswerRefused, MessageError
from rossec.net.aio.tasks import TaskSet
from rossec.node import Node, Subscriber
from rossec.operation.process_memory import protect_memory
from rossec.operation.shutdown import until_first_ends

NAME: Final = "/console"
PERIOD: Final = 3.0  # seconds between two looks for topics
PER_SECOND: Final = 10  # messages of one topic
_RETRY: Final = 10.0
_log = logging.getLogger("rossec.console")


class PreviewReceiver:
    """Receives as `/console`, and writes frames.

    Args:
        writer: to the pages.
        environ: of the node.
        period: seconds between two looks for topics.
    """

    def __init__(
        self, writer: asyncio.StreamWriter, environ: Mapping[str, str], period: float = PERIOD
    ) -> None:
        self._writer = writer
        self._environ = environ
        self._period = period
        self._subscribers: dict[str, Subscriber] = {}

    async def run(self) -> None:
        """Receive until cancelled; a master that is away is tried again."""
        while True:
            try:
                environ = await discover_master(self._environ, NAME)
                async with Node(NAME, environ=environ) as node:
                    await self._follow(node)
            except (HintedError, OSError) as error:
                _log.warning("the preview does not run now: %s", error)
            self._subscribers.clear()
            await asyncio.sleep(_RETRY)

    async def _follow(self, node: Node) -> None:
        tasks = TaskSet()
        try:
            while True:
                found = await node.topic_types()
                await self._end_lost(node)
                for topic, kind in sorted(found.items()):
                    if self._is_new(node, topic):
                        with suppress(AnswerRefused, MessageError):  # ended since; unknown type
                            subscriber = await node.subscriber(topic, kind)
                            self._subscribers[topic] = subscriber
                            tasks.spawn(self._pass_on(subscriber, kind), f"preview of {topic}")
                await asyncio.sleep(self._period)
        finally:
            await tasks.close()

    def _is_new(self, node: Node, topic: str) -> bool:
        return (
            topic not in self._subscribers
            and len(self._subscribers) < MAX_TOPICS
            and node.access.holds(Right.SUBSCRIBE, topic, clock.now())
        )

    async def _end_lost(self, node: Node) -> None:
        """Unsubscribe from what it may not receive any more."""
        for topic in tuple(self._subscribers):
            if not node.access.holds(Right.SUBSCRIBE, topic, clock.now()):
                await self._subscribers.pop(topic).close()

    async def _pass_on(self, subscriber: Subscriber, kind: str) -> None:
        next_at = 0.0
        async for data in subscriber.raw():
            at = clock.time()
            if at < next_at or len(data) > frames.MAX_DATA:
                continue
            next_at = at + 1 / PER_SECOND
            self._writer.write(frames.write(PreviewMessage(subscriber.topic, kind, at, data)))
            await self._writer.drain()


async def receive(sock: socket.socket, environ: Mapping[str, str]) -> None:
    """Run until the pages end their end of the socketpair."""
    reader, writer = await asyncio.open_connection(sock=sock)
    try:
        await until_first_ends(PreviewReceiver(writer, environ).run(), reader.read(1))
    except ConnectionError:
        return
    finally:
        writer.transport.abort()


def main(arguments: list[str]) -> None:
    """Run it. Argument: the descriptor of its socket."""
    logging.basicConfig(level=logging.WARNING)
    protect_memory()
    asyncio.run(receive(socket.socket(fileno=int(arguments[0])), os.environ))


if __name__ == "__main__":
    main(sys.argv[1:])
