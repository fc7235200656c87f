"""A node that runs for one command."""

import asyncio
from collections.abc import Coroutine
from typing import Any

from rossec.node import Node


async def until(node: Node, work: Coroutine[Any, Any, None]) -> None:
    """Work until it is done, or until the node ends by itself: that is an error then.

    Nothing works on when this ends, however it ends: Ctrl-C closes the node next.
    """
    tasks = [asyncio.ensure_future(node.wait_ended()), asyncio.ensure_future(work)]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    for task in done:
        await task
