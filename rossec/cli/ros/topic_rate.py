"""`rossec topic hz | bw`: how often messages arrive, and how much they are."""

import asyncio
import time
from collections.abc import Callable
from typing import Final

import click

from rossec.cli.ros.listening import Arrivals, listening
from rossec.cli.ros.windows import RateWindow, SizeWindow
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.running import run_until_node_ends
from rossec.cli.shared.system_state import as_node
from rossec.terminal import note, say_block

PERIOD: Final = 1.0  # seconds between two lines
_WINDOW = click.option(
    "--window", "-w", type=click.IntRange(min=2), help="of the last N messages only", metavar="N"
)
_COUNT = click.option("--count", "-n", type=click.IntRange(min=1), help="end after N lines")

Add = Callable[[float, int], None]


@click.command()
@click.argument("name")
@as_node
@_WINDOW
@_COUNT
@pass_environment
def hz(
    environment: Environment, name: str, node: str, window: int | None, count: int | None
) -> None:
    """Show how often messages of the topic NAME arrive, as NODE may see them."""
    rates = RateWindow(window)
    asyncio.run(
        _watch(environment, name, node, lambda now, _: rates.add(now), rates.describe, count)
    )


@click.command()
@click.argument("name")
@as_node
@_WINDOW
@_COUNT
@pass_environment
def bw(
    environment: Environment, name: str, node: str, window: int | None, count: int | None
) -> None:
    """Show how many bytes of the topic NAME arrive, as NODE may see them."""
    sizes = SizeWindow(window or 100)  # rostopic's

    def describe() -> str:
        return sizes.describe(time.monotonic())

    asyncio.run(_watch(environment, name, node, sizes.add, describe, count))


async def _watch(
    environment: Environment,
    name: str,
    node: str,
    add: Add,
    describe: Callable[[], str],
    count: int | None,
) -> None:
    async with listening(environment, name, node) as (running, arrivals):
        note(f"subscribed to [{name}]")
        await run_until_node_ends(running, _count_and_say(arrivals, add, describe, count))


async def _count_and_say(
    arrivals: Arrivals, add: Add, describe: Callable[[], str], count: int | None
) -> None:
    counting = asyncio.ensure_future(_count(arrivals, add))
    try:
        lines = 0
        while count is None or lines < count:
            await asyncio.sleep(PERIOD)
            say_block(describe())
            lines += 1
    finally:
        counting.cancel()
        await asyncio.gather(counting, return_exceptions=True)


async def _count(arrivals: Arrivals, add: Add) -> None:
    async for _, data in arrivals.messages():
        add(time.monotonic(), len(data))
