import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

import pytest

from rossec.enrollment.sessions import Serve, SessionServer
from rossec.net.limits import HalfOpenLimits
from tests.support.witness import until

HOST = "127.0.0.1"
TWO = HalfOpenLimits(per_address=2, total=8)


async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, address: str) -> None:
    while data := await reader.read(100):
        writer.write(address.encode() + b" " + data)


async def wait(reader: asyncio.StreamReader, *_: object) -> None:
    await reader.read()


@asynccontextmanager
async def listening(serve: Serve, caps: HalfOpenLimits = TWO) -> AsyncIterator[SessionServer]:
    server = SessionServer(serve, caps)
    await server.listen(HOST, 0)
    try:
        yield server
    finally:
        await server.close()


async def test_a_session_knows_its_peer_and_ends_with_it() -> None:
    async with listening(echo) as server:
        reader, writer = await asyncio.open_connection(HOST, server.port)
        writer.write(b"hello")
        assert await reader.readexactly(15) == b"127.0.0.1 hello"
        assert len(server) == 1
        writer.write_eof()
        assert await reader.read() == b"", "what serve left open is closed"
        writer.close()
        await until(lambda: len(server) == 0)


async def test_an_address_has_a_limited_number_of_sessions() -> None:
    async with listening(wait) as server:
        peers = [await asyncio.open_connection(HOST, server.port) for _ in range(2)]
        await until(lambda: len(server) == 2)
        refused, writer = await asyncio.open_connection(HOST, server.port)
        with suppress(ConnectionResetError):
            assert await refused.read() == b""
        assert len(server) == 2
        for _, open_writer in [*peers, (refused, writer)]:
            open_writer.close()
        await until(lambda: len(server) == 0)


async def test_a_peer_that_is_gone_before_it_was_accepted_gets_no_session() -> None:
    class Gone:
        def get_extra_info(self, _: str) -> None:
            return None

        class transport:  # noqa: N801
            aborted = False

            @classmethod
            def abort(cls) -> None:
                cls.aborted = True

    async with listening(wait) as server:
        server.accept(asyncio.StreamReader(), Gone())  # type: ignore[arg-type]  # a writer
        assert Gone.transport.aborted
        assert len(server) == 0


async def test_a_session_that_crashes_frees_its_place() -> None:
    async def crash(*_: object) -> None:
        raise OSError("gone")

    async with listening(crash) as server:
        reader, writer = await asyncio.open_connection(HOST, server.port)
        with suppress(ConnectionResetError):
            assert await reader.read() == b""
        writer.close()
        await until(lambda: len(server) == 0)


async def test_open_sessions_go_on_without_listening_and_end_when_it_is_closed() -> None:
    async with listening(echo) as server:
        reader, writer = await asyncio.open_connection(HOST, server.port)
        await until(lambda: len(server) == 1)
        server.stop_listening()
        writer.write(b"x")
        assert await reader.readexactly(11) == b"127.0.0.1 x"
        with pytest.raises(ConnectionRefusedError):
            await asyncio.open_connection(HOST, server.port)
        await server.close()
        with suppress(ConnectionResetError):
            assert await reader.read() == b""
        writer.close()
