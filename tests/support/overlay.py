"""Routers of the overlay in this process, open to all, and carriers that use them."""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager

from rossec.overlay.documents import OPEN_ACCOUNT, Routers
from rossec.overlay.router_settings import COMMON
from rossec.overlay.zenoh_carrier import Carrier, open_session
from tests.support.ports import free_port


@contextmanager
def router(locator: str = "") -> Iterator[str]:
    """A router without accounts; its locator."""
    where = locator or f"tcp/127.0.0.1:{free_port()}"
    session = open_session({**COMMON, "mode": "router", "listen/endpoints": [where]})
    try:
        yield where
    finally:
        session.close()  # type: ignore[no-untyped-call]


def routers_at(*locators: str) -> Routers:
    return Routers(locators, OPEN_ACCOUNT)


@asynccontextmanager
async def carrier(*locators: str) -> AsyncIterator[Carrier]:
    """A relay's session with one of these routers."""
    opened = await Carrier.open(routers_at(*locators))
    try:
        yield opened
    finally:
        await opened.close()


async def until(condition: Callable[[], object], seconds: float = 20) -> None:
    """Wait for what no event tells."""
    async with asyncio.timeout(seconds):
        while not condition():  # noqa: ASYNC110 - there is none
            await asyncio.sleep(0.002)
