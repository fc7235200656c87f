"""Keeps the server's certificate new while the console runs. A shell around `certificates`."""

import asyncio
from collections.abc import Awaitable, Callable

from rossec.console.tls.certificates import PERIOD, CertificateSource

Install = Callable[[bytes], Awaitable[None]]


def renewed_from(
    source: CertificateSource, now: Callable[[], int], period: float = PERIOD
) -> Callable[[Install], Awaitable[None]]:
    """A function that installs the first bundle of `source`, then every newer one, for ever.

    It may be run again: a server that was started anew begins with a first bundle.
    """

    async def install_all(install: Install) -> None:
        bundle: bytes | None = await asyncio.to_thread(source.first, now())
        while True:
            if bundle is not None:
                await install(bundle)
            await asyncio.sleep(period)
            bundle = await asyncio.to_thread(source.newer, now())

    return install_all
