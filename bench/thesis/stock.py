"""The same node in plain ROS: `python -m bench.thesis.stock NAME publish|subscribe`, with rospy."""

import asyncio
import json
import sys
from typing import Any

import rospy
from std_msgs.msg import String

from bench.thesis.node import Arrivals, send, tell
from bench.thesis.talk import TOPIC, Point


class Serialized(String):  # type: ignore[misc]  # genpy has no types
    """A String that is serialized already, as the built-in node is given it."""

    def serialize(self, buff: Any) -> None:
        """Write it as it is."""
        buff.write(self.data)


def main(name: str, role: str) -> None:
    """Be that node."""
    rospy.init_node(name.strip("/"), disable_signals=True, disable_rosout=True)
    arrivals = Arrivals()
    if role == "publish":
        publisher = rospy.Publisher(TOPIC, Serialized, queue_size=10)
    else:
        rospy.Subscriber(TOPIC, rospy.AnyMsg, lambda got: arrivals.add(got._buff))  # noqa: SLF001
        publisher = None

    async def act(order: dict[str, Any]) -> object:
        if publisher is None:
            return await arrivals.act(order)
        if "links" in order:
            while publisher.get_num_connections() != order["links"]:  # noqa: ASYNC110
                await asyncio.sleep(0.02)
            return None
        return await send(
            lambda data: publisher.publish(Serialized(data)), order["number"], Point(**order["point"])
        )

    tell("ready")
    for line in sys.stdin:
        tell(asyncio.run(act(json.loads(line))))


if __name__ == "__main__":
    main(*sys.argv[1:])
