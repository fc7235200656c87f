"""Nodes: `/lamp` provides a service, `/hall` calls it."""

from collections.abc import AsyncIterator

import pytest

from grants.model import Right
from rossec.node import Node
from tests.support.site import Site


@pytest.fixture
async def lamp(site: Site) -> AsyncIterator[Node]:
    site.grant("/lamp", Right.PROVIDE, "/lamp/*")
    async with site.node("/lamp") as lamp:
        yield lamp


@pytest.fixture
async def hall(site: Site) -> AsyncIterator[Node]:
    site.grant("/hall", Right.CALL, "/lamp/*")
    async with site.node("/hall") as hall:
        yield hall
