"""Secure streams over loopback: a server that echoes, its clients, lasting certificates."""

import asyncio
import contextlib

from rossec.channel.opening import WireProtocol
from rossec.net.aio import SecureServer, SecureStream, connect
from tests.support.contexts import context
from tests.support.wire import ALICE, FakeIdentity

Stream = SecureStream[FakeIdentity]


async def echo(stream: Stream) -> None:
    while True:
        await stream.send(await stream.receive())


async def call(server: SecureServer[FakeIdentity], protocol: WireProtocol = WireProtocol.TCPROS) -> Stream:
    return await connect("127.0.0.1", server.port, context(ALICE), protocol)


async def still_works(server: SecureServer[FakeIdentity]) -> None:
    async with await call(server) as stream:
        await stream.send(b"ping")
        assert await stream.receive() == b"ping"


async def raw(server: SecureServer[FakeIdentity], data: bytes) -> bytes:
    """What a caller without rossec reads until the end."""
    reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
    writer.write(data)
    answer = await reader.read()
    writer.close()
    with contextlib.suppress(OSError):
        await writer.wait_closed()
    return answer
