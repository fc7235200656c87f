"""Frames of the enrollment on asyncio streams."""

import asyncio

from ca.enrollment.messages import HEADER_SIZE, frame, length


async def receive(reader: asyncio.StreamReader) -> bytes:
    """The next message; its size is checked before it is read.

    Raises:
        EnrollmentMessageRefused: too long.
        EOFError: the other side has closed.
        OSError: the connection broke.
    """
    size = length(await reader.readexactly(HEADER_SIZE))
    return await reader.readexactly(size)


def send(writer: asyncio.StreamWriter, message: bytes) -> None:
    """Queue a message; they are few and small."""
    writer.write(frame(message))
