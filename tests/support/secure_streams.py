"""Secure streams over loopback: a server that echoes, its clients, lasting certificates."""

from rossec.channel.opening import WireProtocol
from rossec.net.aio import SecureServer, SecureStream, connect
from tests.support.wire import ALICE, FakeIdentity, trust

Stream = SecureStream[FakeIdentity]


LIVE = 1 << 40  # a not_after later than the host's clock


def live(chain: tuple[bytes, ...], now: int) -> FakeIdentity:
    found = trust(chain, now)
    return FakeIdentity(found.name, found.public_key, found.certificate, LIVE)


async def echo(stream: Stream) -> None:
    while True:
        await stream.send(await stream.receive())


async def call(
    server: SecureServer[FakeIdentity], opening: WireProtocol = WireProtocol.TCPROS
) -> Stream:
    return await connect("127.0.0.1", server.port, ALICE, live, opening=opening)


async def still_works(server: SecureServer[FakeIdentity]) -> None:
    async with await call(server) as stream:
        await stream.send(b"ping")
        assert await stream.receive() == b"ping"
