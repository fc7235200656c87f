"""Keeps the server's certificate new while the console runs. A shell around `certificates`."""

import asyncio
from collections.abc import Awaitable, Callable

from rossec.console.tls.certificates import PERIOD, CertificateSource


async def keep_renewed(
    source: CertificateSource,
    use: Callable[[bytes], Awaitable[None]],
    now: Callable[[], int],
    period: float = PERIOD,
) -> None:
    """Give every newer bundle of `source` to `use`, until this is cancelled."""
    while True:
        await asyncio.sleep(period)
        bundle = await asyncio.to_thread(source.newer, now())
        if bundle is not None:
            await use(bundle)
