import asyncio
from contextlib import suppress

import pytest

from rossec.console.tls.certificates import renewed_from
from rossec.errors import ConfigurationError


class FakeSource:
    """Has a newer bundle at every second look."""

    def __init__(self) -> None:
        self.looks = 0

    def first(self, now: int) -> bytes:
        if now < 0:
            raise ConfigurationError("it has expired")
        return b"first at %d" % now

    def newer(self, now: int) -> bytes | None:
        self.looks += 1
        return b"newer %d" % self.looks if self.looks % 2 == 0 else None


async def test_the_first_bundle_and_newer_ones_are_installed_as_they_come() -> None:
    used: list[bytes] = []

    async def install(bundle: bytes) -> None:
        used.append(bundle)
        if len(used) == 3:
            raise asyncio.CancelledError

    run = renewed_from(FakeSource(), lambda: 7, period=0.001)
    for _ in range(2):  # a server that ended is started again
        used.clear()
        with suppress(asyncio.CancelledError):
            await asyncio.wait_for(run(install), 10)
        assert used[0] == b"first at 7"
        assert [bundle[:5] for bundle in used[1:]] == [b"newer"] * 2


async def test_a_source_without_a_first_bundle_ends_it() -> None:
    async def install(_: bytes) -> None:
        raise AssertionError

    with pytest.raises(ConfigurationError, match="it has expired"):
        await renewed_from(FakeSource(), lambda: -1)(install)
