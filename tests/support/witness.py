"""A pair of nodes that must not be disturbed: numbered messages, none lost, one connection."""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable

from rossec.node import Node, Publisher, Subscriber
from tests.support.site import Site

POSE = "geometry_msgs/PoseStamped"
TOPIC = "/robot/pose"
FRAME = "living_room_map"
_PERIOD = 0.002
_FAR = 1_000_000  # queues long enough that only a disturbance loses a message


class Witness:
    """The robot publishes and the viewer listens during an attack."""

    def __init__(self, robot: Node, viewer: Node, pose: Publisher, sight: Subscriber) -> None:
        self.robot = robot
        self.viewer = viewer
        self.publisher = pose
        self.subscriber = sight
        self.sent = 0
        self.seen: list[int] = []

    @property
    def topic_port(self) -> int:
        return self.robot.topic_endpoint()[1]

    async def goes_on(self, messages: int = 20) -> None:
        """Wait until `messages` more have arrived, all numbers in order."""
        wanted = self.sent + messages
        await until(lambda: bool(self.seen) and self.seen[-1] >= wanted)
        assert self.seen == list(range(self.seen[-1] + 1))

    async def _publish(self) -> None:
        while True:
            message = self.publisher.create()
            message.header.seq, message.header.frame_id = self.sent, FRAME
            message.pose.position.x = 3.3
            self.publisher.publish(message)
            self.sent += 1
            await asyncio.sleep(_PERIOD)

    async def _listen(self) -> None:
        async for message in self.subscriber:
            self.seen.append(message.header.seq)


@contextlib.asynccontextmanager
async def undisturbed(site: Site) -> AsyncIterator[Witness]:
    """Run the pair; at the end every message has arrived over the first connection."""
    site.publish("/robot", TOPIC)
    site.subscribe("/viewer", TOPIC)
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        pose = await robot.publisher(TOPIC, POSE, queue_size=_FAR)
        sight = await viewer.subscriber(TOPIC, POSE, queue_size=_FAR)
        await pose.wait_for_subscribers()
        witness = Witness(robot, viewer, pose, sight)
        links = set(pose.links)
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(witness._publish()), group.create_task(witness._listen())]
            try:
                await witness.goes_on()
                yield witness
                await witness.goes_on()
                assert set(pose.links) == links, "the pair reconnected, or another peer connected"
            finally:
                for task in tasks:
                    task.cancel()


async def until(holds: Callable[[], object], within: float = 30.0) -> None:
    """Poll for a condition; fail when it is not met in time."""
    end = time.monotonic() + within
    while not holds():
        assert time.monotonic() < end, "it did not come to hold in time"
        await asyncio.sleep(0.005)
