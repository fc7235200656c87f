import asyncio
import logging
import socket
from collections.abc import AsyncIterator
from typing import NamedTuple

import pytest

from rossec.console import samples
from rossec.console.samples import PreviewMessage
from rossec.console.server.web import PreviewClient

NOW = 1_800_000_000.0


class Pair(NamedTuple):
    client: PreviewClient
    sender: socket.socket

    async def until_recorded(self, topic: str) -> None:
        async with asyncio.timeout(30):
            while self.client.recorded(topic) is None:  # noqa: ASYNC110 - another task's memory
                await asyncio.sleep(0.001)


@pytest.fixture
async def pair() -> AsyncIterator[Pair]:
    ours, theirs = socket.socketpair()
    client = PreviewClient(ours, lambda: NOW)
    client.start()
    yield Pair(client, theirs)
    await client.close()
    theirs.close()


async def test_messages_are_kept_as_they_come(pair: Pair) -> None:
    data = samples.write_preview(PreviewMessage("/t", "std_msgs/String", NOW, b"one"))
    pair.sender.sendall(data[:7])
    await asyncio.sleep(0)
    pair.sender.sendall(data[7:] + data)
    await pair.until_recorded("/t")
    await asyncio.sleep(0.01)
    recorded = pair.client.recorded("/t")
    assert recorded is not None
    assert recorded.messages == ((NOW, b"one"),) * 2
    assert not recorded.is_made_up


@pytest.mark.parametrize("data", [b"\xff\xff\xff\xff", b"\0\0\0\x01\x00"])
async def test_a_broken_protocol_ends_it(pair: Pair, data: bytes, caplog: pytest.LogCaptureFixture) -> None:
    pair.sender.sendall(data)
    async with asyncio.timeout(30):
        await asyncio.to_thread(pair.sender.recv, 1)  # the end of the connection
    assert "the preview breaks the protocol" in caplog.text


async def test_the_end_of_the_receiver_is_no_end_of_the_pages(
    pair: Pair, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    pair.sender.sendall(samples.write_preview(PreviewMessage("/t", "T", NOW, b"one")))
    await pair.until_recorded("/t")
    pair.sender.close()
    async with asyncio.timeout(30):
        while "the preview has ended" not in caplog.text:  # noqa: ASYNC110 - another task logs
            await asyncio.sleep(0.001)
    assert pair.client.recorded("/t") is not None
