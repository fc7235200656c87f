"""The demo's robot: drives a circle and publishes its pose, a laser scan and a camera image.

Run as `python -I -m rossec.demo.robot`; reports on stdout, one JSON object a line.
"""

import asyncio
import itertools
import math
import time
from typing import Any

import numpy as np

from rossec.node import Node, Publisher
from rossec.terminal import say_json

NAME = "/robot"
POSE = ("/robot/pose", "geometry_msgs/PoseStamped")
SCAN = ("/robot/scan", "sensor_msgs/LaserScan")
CAMERA = ("/robot/camera", "sensor_msgs/Image")
FRAME = "living_room_map"
PERIOD = 0.05
_WIDTH, _HEIGHT, _RAYS = 320, 240, 360


async def main() -> None:
    async with Node(NAME) as node:
        pose = await node.publisher(*POSE)
        scan = await node.publisher(*SCAN)
        camera = await node.publisher(*CAMERA)
        say_json({"ready": node.uri, "tcpros": node.topic_endpoint()[1]})
        for tick in itertools.count():
            publish_pose(pose, tick)
            publish_scan(scan, tick)
            publish_image(camera, tick)
            await asyncio.sleep(PERIOD)


def publish_pose(publisher: Publisher, tick: int) -> None:
    # A circle of three metres around (1.37, 2.71), a turn in ten seconds: over several squares of the
    # heating.
    angle = 2 * math.pi * tick * PERIOD / 10
    message = publisher.create()
    _stamp(message.header, tick)
    message.pose.position.x = 1.37 + 3 * math.cos(angle)
    message.pose.position.y = 2.71 + 3 * math.sin(angle)
    message.pose.orientation.z = math.sin(angle / 2)
    message.pose.orientation.w = math.cos(angle / 2)
    publisher.publish(message)


def publish_scan(publisher: Publisher, tick: int) -> None:
    rays = np.arange(_RAYS, dtype=np.float32)
    message = publisher.create(
        angle_min=-math.pi, angle_max=math.pi, angle_increment=2 * math.pi / _RAYS, range_max=10.0
    )
    _stamp(message.header, tick)
    message.ranges = 4 + 0.25 * np.sin(rays / 9 + tick, dtype=np.float32)
    publisher.publish(message)


def publish_image(publisher: Publisher, tick: int) -> None:
    message = publisher.create(height=_HEIGHT, width=_WIDTH, encoding="mono8", step=_WIDTH)
    _stamp(message.header, tick)
    ramp = (np.arange(_WIDTH, dtype=np.uint16) + tick).astype(np.uint8)
    message.data = np.tile(ramp, _HEIGHT)
    publisher.publish(message)


def _stamp(header: Any, tick: int) -> None:
    seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
    header.seq = tick
    header.stamp.sec, header.stamp.nanosec = seconds, nanoseconds
    header.frame_id = FRAME


if __name__ == "__main__":
    asyncio.run(main())
