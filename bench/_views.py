"""What a receiver is sent: messages through the guard of the product, by one connection or many."""

import itertools
import struct
from collections.abc import Iterable, Iterator
from types import SimpleNamespace
from typing import Any, Final

from grants.decision import Decision
from grants.filters.compile import preset
from grants.filters.layout import Layout, parse
from grants.guard import Guard, MemoryScope, MemoryStore
from grants.model import Restriction, Right
from rossec.participant.message_types import message_type

NOW: Final = 1_800_000_000
_KEYS: Final = {"diagnostics": bytes(range(32))}


def layout(type_name: str) -> Layout:
    """The layout of a standard type."""
    return parse(type_name, message_type(type_name).definition)


def by_preset(name: str, type_name: str) -> Restriction:
    """The restriction of a preset."""
    return preset(name).restriction(layout(type_name))


class Publisher:
    """One program that publishes, with its memory of every receiver."""

    def __init__(self, type_name: str) -> None:
        self._layout = layout(type_name)
        self._scope = MemoryScope(MemoryStore(lambda: NOW), ("/publisher",))

    def guard(self, restriction: Restriction, receiver: int = 1, topic: str = "/topic") -> Guard:
        """The guard of one connection of a receiver."""
        grant: Any = SimpleNamespace(holder=bytes([receiver]) * 32, chain=())
        grant.links = (grant,)
        decision = Decision(Right.SUBSCRIBE, topic, (grant,), NOW * 2, (restriction,))
        return Guard(self._layout, decision, _KEYS, self._scope)


def received(
    type_name: str,
    restriction: Restriction,
    messages: Iterable[tuple[float, bytes]],
    every: int | None = None,
) -> Iterator[tuple[float, bytes]]:
    """When what arrives, seconds from `NOW`; with a new connection for `every` so many messages."""
    publisher = Publisher(type_name)
    guard = publisher.guard(restriction)
    for number, (at, message) in enumerate(messages):
        if every is not None and number % every == 0:
            guard = publisher.guard(restriction)
        pieces = guard.apply(message, NOW + at)
        if pieces is not None:
            yield at, b"".join(pieces)


_HEADER: Final = struct.Struct("<IIII3s")


def header(number: int, at: float, frame: bytes = b"map") -> bytes:
    """A Header of the frame `map`, or of another with three letters."""
    whole, rest = divmod(NOW + at, 1)
    return _HEADER.pack(number, int(whole), int(rest * 1e9), 3, frame)


def poses(path: Any, rate: int, frame: bytes = b"map") -> Iterator[tuple[float, bytes]]:
    """PoseStamped messages of a path."""
    for number, (x, y) in enumerate(path.tolist()):
        at = number / rate
        yield at, header(number, at, frame) + struct.pack("<7d", x, y, 0, 0, 0, 0, 1)


def pose_place(message: bytes) -> tuple[float, float]:
    """The x and y that a PoseStamped says."""
    x, y = struct.unpack_from("<2d", message, _HEADER.size)
    return x, y


def text(value: bytes) -> bytes:
    """A serialized string."""
    return len(value).to_bytes(4, "little") + value


def strings(message: bytes, at: int, count: int) -> tuple[list[bytes], int]:
    """So many strings from there on, and where they end."""
    found = []
    for _ in itertools.repeat(None, count):
        length = int.from_bytes(message[at : at + 4], "little")
        found.append(message[at + 4 : at + 4 + length])
        at += 4 + length
    return found, at
