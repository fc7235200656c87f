"""Print three messages of /chatter, or why there are none. Needs 1_talker.py running."""

import asyncio
import sys

from ca.errors import HintedError
from rossec.node import Node


async def main() -> None:
    async with Node("/listener", argv=sys.argv[1:]) as node:
        chatter = await node.subscriber("/chatter", "std_msgs/String")
        messages = aiter(chatter)
        for _ in range(3):
            message = await anext(messages)
            print(message.data)


try:
    asyncio.run(main())
except HintedError as error:
    sys.exit(f"{error}\n{error.hint}")
