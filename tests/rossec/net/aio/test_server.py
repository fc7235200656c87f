"""Listening: ports, caps of half-open connections, plain callers, handlers."""

import asyncio
import contextlib
import errno
import logging
import socket

import pytest

from rossec.channel.opening import REFUSAL, WireProtocol
from rossec.channel.records import ChannelLimits
from rossec.errors import (
    ChannelError,
    ConnectionTruncated,
    HandshakeFailed,
    PeerUnreachable,
    PlainPeer,
)
from rossec.net.aio import SecureServer, connect, serve
from rossec.net.aio import server as server_module
from rossec.net.aio.server import bind
from rossec.net.halfopen import HalfOpen, HalfOpenCount, source_of
from tests.support.contexts import context
from tests.support.secure_streams import Stream, call, echo, still_works
from tests.support.wire import ALICE, BOB, FakeIdentity


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost"])
async def test_both_families_on_one_port(host: str) -> None:
    async with serve(echo, None, 0, context(BOB)) as server:
        stream = await connect(host, server.port, context(ALICE))
        await stream.send(b"x")
        assert await stream.receive() == b"x"
        await stream.close()


async def test_a_crashing_handler_ends_only_its_connection(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def picky(stream: Stream) -> None:
        unit = await stream.receive()
        await stream.send(bytes([100 // unit[0]]))
        await echo(stream)

    async with serve(picky, "127.0.0.1", 0, context(BOB)) as server:
        bad, good = await call(server), await call(server)
        await bad.send(b"\x00")
        with pytest.raises(ChannelError):
            await bad.receive()
        await good.send(b"\x0a")
        assert await good.receive() == b"\x0a"
        await good.close()
    assert "crashed" in caplog.text
    assert "ZeroDivisionError" in caplog.text


async def test_closing_the_server_ends_everything() -> None:
    server = serve(echo, "127.0.0.1", 0, context(BOB))
    stream = await call(server)
    await stream.send(b"x")
    await stream.receive()
    await server.close()
    with pytest.raises(ConnectionTruncated):
        await stream.receive()
    assert server.connections == 0
    with pytest.raises(PeerUnreachable, match="cannot connect") as caught:
        await call(server)
    assert "ROS_HOSTNAME" in caught.value.hint


async def raw(server: SecureServer[FakeIdentity], data: bytes) -> bytes:
    reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
    writer.write(data)
    answer = await reader.read()
    writer.close()
    with contextlib.suppress(OSError):
        await writer.wait_closed()
    return answer


async def test_a_plain_tcpros_client_reads_why(server: SecureServer[FakeIdentity]) -> None:
    fields = [b"callerid=/listener", b"topic=/secret", b"message_definition=" + b"x" * 6000]
    body = b"".join(len(field).to_bytes(4, "little") + field for field in fields)
    answer = await raw(server, len(body).to_bytes(4, "little") + body)
    assert answer[8:] == b"error=" + REFUSAL.encode()
    assert int.from_bytes(answer[:4], "little") == len(answer) - 4
    assert b"secret" not in answer
    await still_works(server)


async def test_a_plain_xmlrpc_client_reads_why(server: SecureServer[FakeIdentity]) -> None:
    from xmlrpc.client import ServerProxy

    def ask() -> object:
        with ServerProxy(f"http://127.0.0.1:{server.port}/RPC2") as proxy:
            return proxy.requestTopic("/listener", "/secret" * 20000, [["TCPROS"]])

    assert await asyncio.to_thread(ask) == [-1, REFUSAL, 0]
    await still_works(server)


@pytest.mark.parametrize("data", [b"\xff" * 64, b"\x16\x03\x01\x02\x00\x01", b"GET " + b"x" * 9000])
async def test_garbage_is_dropped(server: SecureServer[FakeIdentity], data: bytes) -> None:
    with contextlib.suppress(OSError):
        assert await raw(server, data) == b""
    await still_works(server)


async def test_the_handshake_deadline(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    limits = ChannelLimits(handshake_seconds=1)
    async with serve(echo, "127.0.0.1", 0, context(BOB, limits=limits)) as server:
        stream = await call(server)
        assert await raw(server, b"\x0c\0\0") == b""
        assert "did not finish the handshake in time" in caplog.text
        await stream.send(b"x")
        assert await stream.receive() == b"x"
        await stream.close()


@pytest.mark.parametrize("caps", [HalfOpen(per_address=3), HalfOpen(total=3)])
async def test_half_open_caps_spare_the_others(caps: HalfOpen) -> None:
    async with serve(echo, "127.0.0.1", 0, context(BOB, half_open=HalfOpenCount(caps))) as server:
        stream = await call(server)
        idle = [await asyncio.open_connection("127.0.0.1", server.port) for _ in range(3)]
        with contextlib.suppress(OSError):
            assert await raw(server, b"") == b""
        with pytest.raises(HandshakeFailed):
            await call(server)
        await stream.send(b"x")
        assert await stream.receive() == b"x"
        for _, writer in idle:
            writer.close()
        await asyncio.sleep(0.05)
        await still_works(server)
        await stream.close()


async def test_the_ports_of_a_context_share_its_limit() -> None:
    own = context(BOB, half_open=HalfOpenCount(HalfOpen(total=1)))
    async with serve(echo, "127.0.0.1", 0, own) as one, serve(echo, "127.0.0.1", 0, own) as other:
        _, idle = await asyncio.open_connection("127.0.0.1", one.port)
        with pytest.raises(HandshakeFailed):
            await call(other)
        idle.close()
        await asyncio.sleep(0.05)
        await still_works(other)


async def test_a_port_has_one_protocol() -> None:
    async with serve(echo, "127.0.0.1", 0, context(BOB)) as server:
        with pytest.raises(PlainPeer):
            await call(server, WireProtocol.HTTP)
        await still_works(server)


async def test_a_caller_that_closes_at_once_releases_its_slot(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    only = HalfOpen(total=1)
    async with serve(echo, "127.0.0.1", 0, context(BOB, half_open=HalfOpenCount(only))) as server:
        gone: list[str] = []

        def broken(*_: object) -> None:
            gone.append("reset")
            raise OSError(errno.EINVAL, "reset")

        with monkeypatch.context() as patch:
            patch.setattr(server_module, "SecureStream", broken)
            with contextlib.suppress(OSError):
                assert await raw(server, b"") == b""
        assert gone
        await still_works(server)


def test_what_counts_as_one_source() -> None:
    assert source_of("192.0.2.1") == "192.0.2.1"
    assert source_of("::ffff:192.0.2.1") == "192.0.2.1"
    assert source_of("2001:db8::1") == source_of("2001:db8::2")
    assert source_of("fe80::1%eth0") == "fe80::/64"
    assert source_of("") == ""


def test_binding_by_name_shares_the_port() -> None:
    sockets = bind("localhost", 0)
    assert len({sock.getsockname()[1] for sock in sockets}) == 1
    for sock in sockets:
        sock.close()


def test_binding_without_ipv6(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "has_ipv6", False)
    monkeypatch.setattr(socket, "has_dualstack_ipv6", lambda: False)
    real = socket.create_server

    def no_ipv6(*args: object, **options: object) -> socket.socket:
        if options["family"] == socket.AF_INET6:
            raise OSError
        return real(*args, **options)  # type: ignore[arg-type]  # passes everything on

    monkeypatch.setattr(socket, "create_server", no_ipv6)
    (sock,) = bind(None, 0)
    assert sock.family == socket.AF_INET
    sock.close()


def test_a_port_that_is_taken() -> None:
    taken = socket.create_server(("127.0.0.1", 0))
    with taken, pytest.raises(OSError, match="in use"):
        bind("127.0.0.1", taken.getsockname()[1])


async def test_accepting_goes_on_when_descriptors_come_back(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    class Exhausted(socket.socket):
        failures = 1

        def accept(self) -> tuple[socket.socket, object]:
            if Exhausted.failures:
                Exhausted.failures -= 1
                raise OSError(errno.EMFILE, "too many open files")
            return super().accept()

    def bind_exhausted(host: str | None, port: int) -> list[socket.socket]:
        (sock,) = bind(host, port)
        return [Exhausted(fileno=sock.detach())]

    monkeypatch.setattr(server_module, "bind", bind_exhausted)
    monkeypatch.setattr(server_module, "ACCEPT_PAUSE", 0.01)
    async with serve(echo, "127.0.0.1", 0, context(BOB)) as server:
        await still_works(server)
    assert "too many open files" in caplog.text
    closed = socket.socket()
    closed.close()
    server._add_reader(closed)  # nothing to watch, nothing happens
