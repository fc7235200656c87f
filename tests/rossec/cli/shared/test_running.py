import asyncio

import pytest

from rossec.cli.ros.topic import run_until_node_ends
from rossec.errors import NodeShutdown
from tests.support.site import Site


async def test_the_work_ends_the_command(site: Site) -> None:
    done: list[int] = []

    async def work() -> None:
        done.append(1)

    async with site.node("/robot") as node:
        await run_until_node_ends(node, work())
    assert done == [1]


async def test_an_error_of_the_work_is_the_commands(site: Site) -> None:
    async def work() -> None:
        raise ValueError("inside")

    async with site.node("/robot") as node:
        with pytest.raises(ValueError, match="inside"):
            await run_until_node_ends(node, work())


async def test_a_node_that_ends_cancels_the_work(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    cancelled: list[int] = []
    working = asyncio.Event()

    async def work() -> None:
        try:
            working.set()
            await asyncio.sleep(60)
        except asyncio.CancelledError:
            cancelled.append(1)
            raise

    async def ended() -> None:
        await working.wait()
        raise NodeShutdown("the master ended it")

    async with site.node("/robot") as node:
        monkeypatch.setattr(node, "wait_ended", ended)
        with pytest.raises(NodeShutdown):
            await run_until_node_ends(node, work())
    assert cancelled == [1]
