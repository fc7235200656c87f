"""Inboxes in memory: frames arrive in the next turn of the loop, unless `fate` says otherwise."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field

from rossec.overlay.link_frames import LinkFrameKind, kind_of

Fate = Callable[[str, bytes], int]
"""From an inbox and a frame: how often it arrives there."""


@dataclass
class MemoryReader:
    """An inbox that is read."""

    carrier: "MemoryCarrier"
    key: str

    def close(self) -> None:
        del self.carrier.readers[self.key]


@dataclass
class MemoryCarrier:
    """Any number of ends share it."""

    fate: Fate = lambda _key, _frame: 1
    readers: dict[str, Callable[[bytes], None]] = field(default_factory=dict)
    frames: list[tuple[str, bytes]] = field(default_factory=list)
    reopened: int = 0
    heard_at: float = 0.0

    def put(self, key: str, data: bytes) -> None:
        self.frames.append((key, data))
        for _ in range(self.fate(key, data)):
            asyncio.get_running_loop().call_soon(self._arrive, key, data)

    def _arrive(self, key: str, data: bytes) -> None:
        self.heard_at = asyncio.get_running_loop().time()
        if (callback := self.readers.get(key)) is not None:
            callback(data)

    def subscribe(self, key: str, callback: Callable[[bytes], None]) -> MemoryReader:
        self.readers[key] = callback
        return MemoryReader(self, key)

    def reopen(self) -> None:
        self.reopened += 1

    def sent(self, kind: LinkFrameKind) -> list[tuple[str, bytes]]:
        """What was put of this kind, with its inbox."""
        return [(key, frame) for key, frame in self.frames if kind_of(frame) == kind]
