"""A running master for the tests of its server."""

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack

import pytest

from tests.rossec.master.world import World


@pytest.fixture
async def world() -> AsyncIterator[World]:
    async with AsyncExitStack() as stack:
        world = World(stack)
        await world.start()
        yield world
