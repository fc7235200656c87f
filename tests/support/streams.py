"""Two ends of an in-memory secure stream: units go in at one end and come out at the other."""

import asyncio
from dataclasses import dataclass, field
from typing import Any

from rossec.errors import RossecError


class MemoryClosed(RossecError):
    """What the real stream's ChannelClosed is here."""


@dataclass
class MemoryStream:
    """One end; `peer` is the identity of the other."""

    peer: Any
    inbox: "asyncio.Queue[bytes | None]" = field(default_factory=asyncio.Queue)
    other: "MemoryStream | None" = None
    closed: bool = False

    async def send(self, *pieces: bytes) -> None:
        assert self.other is not None
        if self.closed or self.other.closed:
            raise MemoryClosed("closed")
        self.other.inbox.put_nowait(b"".join(pieces))

    async def receive(self) -> bytes:
        unit = None if self.closed else await self.inbox.get()
        if unit is None:
            self.inbox.put_nowait(None)
            raise MemoryClosed("closed")
        return unit

    def abort(self, reason: str = "") -> None:
        assert self.other is not None
        self.closed = True
        self.inbox.put_nowait(None)
        self.other.inbox.put_nowait(None)

    async def close(self) -> None:
        if not self.closed:
            self.abort()


def stream_pair(left: Any, right: Any) -> tuple[MemoryStream, MemoryStream]:
    """The stream of the peer `left` and the one of `right`: each sees the other as its peer."""
    near, far = MemoryStream(right), MemoryStream(left)
    near.other, far.other = far, near
    return near, far
