"""The records of the master's journals. Pure.

A record is the length and the CRC-32 of its content (4 bytes each, big endian), then the content. A
record that is truncated or damaged ends a journal: it was being written when the power failed. The
CRC detects accidents, not attacks: the file is writable for its owner alone.
"""

import zlib
from collections.abc import Iterator
from typing import Final

_HEADER_SIZE: Final = 8


def frame(content: bytes) -> bytes:
    """One record."""
    return len(content).to_bytes(4) + zlib.crc32(content).to_bytes(4) + content


def contents(data: bytes, at: int) -> Iterator[tuple[bytes, int]]:
    """The content of each undamaged record from `at` on, and where the record ends."""
    while len(data) - at >= _HEADER_SIZE:
        begin = at + _HEADER_SIZE
        at = begin + int.from_bytes(data[at : at + 4])
        content = data[begin:at]
        if len(data) < at or zlib.crc32(content) != int.from_bytes(data[begin - 4 : begin]):
            return
        yield content, at
