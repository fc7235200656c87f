import asyncio
from contextlib import suppress

from rossec.console.tls.renewing import keep_renewed


class Source:
    """Has a newer bundle at every second look."""

    def __init__(self) -> None:
        self.looks: list[int] = []

    def first(self, now: int) -> bytes:
        return b"first"

    def newer(self, now: int) -> bytes | None:
        self.looks.append(now)
        return b"bundle %d" % len(self.looks) if len(self.looks) % 2 == 0 else None


async def test_newer_bundles_are_used_as_they_come() -> None:
    used: list[bytes] = []

    async def use(bundle: bytes) -> None:
        used.append(bundle)
        if len(used) == 2:
            raise asyncio.CancelledError

    source = Source()
    with suppress(asyncio.CancelledError):
        await asyncio.wait_for(keep_renewed(source, use, lambda: 7, period=0.001), 10)
    assert used == [b"bundle 2", b"bundle 4"]
    assert source.looks == [7] * 4
