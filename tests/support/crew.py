"""The nodes of one host in one process: `python -m tests.support.crew`, told what to do by lines.

A line on standard input is a JSON object `{"id", "node", "do", "with"}`; its answer is a line with
the same id and `answer` or `error`. Received messages are lines with `node`, `topic`, `data`, `at`.
Nodes are made when they are first named.
"""

import asyncio
import base64
import json
import sys
import time
from collections.abc import Awaitable, Callable
from typing import Any, Final

from ca.errors import HintedError
from rossec.node import Node, Publisher, Subscriber
from rossec.ros.xmlrpc import Fault
from rossec.terminal import say_json

TYPE: Final = "std_msgs/String"
LAMP: Final = "std_srvs/SetBool"
PERIOD: Final = 0.05  # seconds between two messages of a topic


class Crew:
    """The nodes of this process."""

    def __init__(self, group: asyncio.TaskGroup) -> None:
        self._group = group
        self._nodes: dict[str, Node] = {}
        self._tasks: dict[str, list[asyncio.Task[None]]] = {}
        self._said: dict[tuple[str, str], Publisher] = {}
        self._joining = asyncio.Lock()

    async def node(self, name: str) -> Node:
        async with self._joining:
            if name not in self._nodes:
                node = Node(name)
                await node.__aenter__()
                self._nodes[name] = node
        return self._nodes[name]

    async def publish(self, name: str, topic: str) -> None:
        """Number messages on `topic` from now on."""
        publisher = await (await self.node(name)).publisher(topic, TYPE)
        self._keep(name, self._publish(publisher))

    async def say(self, name: str, topic: str, data: str) -> None:
        """Publish one message, which is latched; the topic is begun with the first."""
        if (name, topic) not in self._said:
            node = await self.node(name)
            self._said[name, topic] = await node.publisher(topic, TYPE, latch=True)
        publisher = self._said[name, topic]
        publisher.publish(publisher.create(data=data))

    async def links(self, name: str, topic: str) -> int:
        """How many subscribers of a topic are connected."""
        return len((await self.node(name)).topics.publishers[topic].links)

    async def subscribe(self, name: str, topic: str) -> None:
        """Print what arrives on `topic` from now on."""
        subscriber = await (await self.node(name)).subscriber(topic, TYPE)
        self._keep(name, self._print(name, subscriber))

    async def provide(self, name: str, service: str) -> None:
        async def switch(request: Any) -> dict[str, object]:
            return {"success": True, "message": f"{name} on is {request.data}"}

        await (await self.node(name)).service(service, LAMP, switch)

    async def call(self, name: str, service: str) -> str:
        message: str = (await (await self.node(name)).client(service, LAMP)(data=True)).message
        return message

    async def ask(self, name: str, method: str, *params: object) -> object:
        """Call the node's master."""
        return await (await self.node(name))._membership.session.call(method, *params)

    async def deliver(self, name: str, method: str, data: str) -> object:
        """Give the node's master a signed list, in base64."""
        return await self.ask(name, method, base64.b64decode(data))

    async def leave(self, name: str) -> None:
        """End the node."""
        for task in self._tasks.pop(name, []):
            task.cancel()
        await self._nodes.pop(name).close()

    def _keep(self, name: str, work: Any) -> None:
        self._tasks.setdefault(name, []).append(self._group.create_task(work))

    @staticmethod
    async def _publish(publisher: Publisher) -> None:
        number = 0
        while True:
            publisher.publish(publisher.create(data=str(number)))
            number += 1
            await asyncio.sleep(PERIOD)

    @staticmethod
    async def _print(name: str, subscriber: Subscriber) -> None:
        async for message in subscriber:
            tell({"node": name, "topic": subscriber.topic, "data": message.data, "at": time.time()})

    async def close(self) -> None:
        for name in list(self._nodes):
            await self.leave(name)


def tell(value: object) -> None:
    say_json(value)
    sys.stdout.flush()


async def carry_out(number: int, work: Callable[..., Awaitable[object]], *given: object) -> None:
    try:
        answer = await work(*given)
    except (HintedError, Fault, OSError) as error:
        tell({"id": number, "error": str(error), "hint": getattr(error, "hint", "")})
    else:
        tell({"id": number, "answer": answer})


async def main() -> None:
    reader = asyncio.StreamReader(limit=1 << 22)
    protocol = asyncio.StreamReaderProtocol(reader)
    await asyncio.get_running_loop().connect_read_pipe(lambda: protocol, sys.stdin)
    async with asyncio.TaskGroup() as group:
        crew = Crew(group)
        while line := await reader.readline():
            order = json.loads(line)
            work = getattr(crew, order["do"])
            group.create_task(carry_out(order["id"], work, order["node"], *order["with"]))
        await crew.close()


if __name__ == "__main__":
    asyncio.run(main())
