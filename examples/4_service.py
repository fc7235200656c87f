"""The talker can be muted: a service and a parameter, used by the listener. Needs 0_enroll.sh and a
running `rossec master`. The listener may only ask for silence where its grant says so."""

import asyncio
from typing import Any

from rossec.node import Node


async def main() -> None:
    async with Node("/talker") as talker, Node("/listener") as listener:

        def mute(request: Any) -> dict[str, object]:
            return {"success": True, "message": "quiet" if request.data else "talking"}

        await talker.service("~mute", "std_srvs/SetBool", mute)
        await listener.wait_for_service("/talker/mute", timeout=10)
        response = await listener.client("/talker/mute", "std_srvs/SetBool")(data=True)
        print(response.message)

        rates = await talker.params.subscribe("~rate")
        await listener.params.set("/talker/rate", 5)
        async for rate in rates:
            if rate == 5:
                print(f"the rate is now {rate}")
                return


asyncio.run(main())
