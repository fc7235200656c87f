"""A node that runs for one command."""

import asyncio
from collections.abc import Coroutine
from typing import Any

from rossec.node import Node


async def run_until_node_ends(node: Node, work: Coroutine[Any, Any, None]) -> None:
    """Run `work`; if the node ends first, cancel it and raise why the node ended.

    Both tasks have ended when this returns, also after Ctrl-C: the node is closed next.
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
