"""Publish on /chatter, ten times a second. Needs 0_enroll.sh and a running `rossec master`."""

import asyncio
import sys

from rossec.node import Node


async def main() -> None:
    async with Node("/talker", argv=sys.argv[1:]) as node:
        chatter = await node.publisher("/chatter", "std_msgs/String")
        count = 0
        while True:
            chatter.publish(chatter.create(data=f"hello {count}"))
            count += 1
            await asyncio.sleep(0.1)


asyncio.run(main())
