"""A robot that speaks: two topics, a service and a parameter, until it is ended."""

import asyncio
from typing import Any

import numpy as np

from rossec.node import Node


async def main() -> None:
    async with Node("/robot") as node:
        await node.params.set("/robot/speed", 1.5)
        pose = await node.publisher("/robot/pose", "geometry_msgs/PoseStamped")
        scan = await node.publisher("/robot/scan", "sensor_msgs/LaserScan")
        await node.publisher("/robot/state", "std_msgs/String")

        def stop(request: Any) -> dict[str, object]:
            return {"success": request.data, "message": "stopped"}

        await node.service("/robot/stop", "std_srvs/SetBool", stop)
        at, ranges = pose.create(), scan.create(ranges=np.ones(3, np.float32))
        at.header.frame_id, at.pose.position.x = "map", 1e-5
        print("the robot is ready", flush=True)  # noqa: T201 - for the test
        while True:
            pose.publish(at)
            scan.publish(ranges)
            await asyncio.sleep(0.05)


if __name__ == "__main__":
    asyncio.run(main())
