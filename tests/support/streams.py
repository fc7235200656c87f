"""Two ends of an in-memory secure stream: units sent at one end are received at the other."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from rossec.errors import RossecError


class MemoryClosed(RossecError):
    """Takes the place of the real stream's ChannelClosed."""


@dataclass
class MemoryStream:
    """One end; `peer` is the identity of the other."""

    peer: Any
    inbox: "asyncio.Queue[bytes | None]" = field(default_factory=asyncio.Queue)
    other: "MemoryStream | None" = None
    closed: bool = False
    lags: bool = False
    callback: Callable[[], None] | None = None
    take: Callable[[bytes], bool] | None = None

    def on_ready(
        self, callback: Callable[[], None] | None, take: Callable[[bytes], bool] | None = None
    ) -> None:
        self.callback, self.take = callback, take

    @property
    def has_unit(self) -> bool:
        return not self.inbox.empty()

    def next_unit(self) -> bytes | None:
        unit = b"" if self.closed else None if self.inbox.empty() else self.inbox.get_nowait() or b""
        if unit == b"":
            raise MemoryClosed("closed")
        return unit

    def write_nowait(self, data: bytes) -> bool:
        self.put(data)
        return not self.lags

    def put(self, unit: bytes) -> None:
        assert self.other is not None
        if self.closed or self.other.closed:
            raise MemoryClosed("closed")
        self.other.arrive(unit)

    def arrive(self, unit: bytes | None) -> None:
        take = self.take if self.inbox.empty() else None
        if unit is not None and take is not None and take(unit):
            return
        self.inbox.put_nowait(unit)
        if self.callback is not None:
            self.callback()

    async def send(self, *pieces: bytes) -> None:
        self.put(b"".join(pieces))

    async def receive(self) -> bytes:
        unit = None if self.closed else await self.inbox.get()
        if unit is None:
            self.inbox.put_nowait(None)
            raise MemoryClosed("closed")
        return unit

    def abort(self, reason: str = "") -> None:
        assert self.other is not None
        self.closed = True
        self.arrive(None)
        self.other.arrive(None)

    async def close(self) -> None:
        if not self.closed:
            self.abort()


def stream_pair(left: Any, right: Any) -> tuple[MemoryStream, MemoryStream]:
    """The stream of the peer `left` and the one of `right`: each sees the other as its peer."""
    near, far = MemoryStream(right), MemoryStream(left)
    near.other, far.other = far, near
    return near, far
