"""Listening: ports, plain callers, descriptors."""

import asyncio
import contextlib
import errno
import socket

import pytest

from rossec.channel.opening import REFUSAL, WireProtocol
from rossec.errors import ConnectionTruncated, PeerUnreachable, PlainPeer
from rossec.net.aio import SecureServer, connect, serve
from rossec.net.aio import server as server_module
from rossec.net.aio.server import bind
from rossec.net.limits import source_of
from tests.support.contexts import context
from tests.support.ports import free_port
from tests.support.secure_streams import call, echo, raw, still_works
from tests.support.wire import ALICE, BOB, FakeIdentity


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost"])
async def test_both_families_on_one_port(host: str) -> None:
    async with serve(echo, None, 0, context(BOB)) as server:
        stream = await connect(host, server.port, context(ALICE))
        await stream.send(b"x")
        assert await stream.receive() == b"x"
        await stream.close()


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


async def test_a_port_has_one_protocol() -> None:
    async with serve(echo, "127.0.0.1", 0, context(BOB)) as server:
        with pytest.raises(PlainPeer):
            await call(server, WireProtocol.HTTP)
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


async def test_a_suspended_port_refuses_and_is_kept() -> None:
    async with serve(echo, "127.0.0.1", free_port(), context(BOB)) as server:
        server.suspend()
        server.suspend()
        with pytest.raises(PeerUnreachable):
            await call(server)
        with pytest.raises(OSError, match="in use"):
            bind("127.0.0.1", server.port)
        server.resume()
        server.resume()
        await still_works(server)


async def test_a_connection_that_cannot_begin_is_closed() -> None:
    async with serve(echo, "127.0.0.1", 0, context(BOB, suites=())) as server:
        crashes: list[object] = []
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, told: crashes.append(told))
        assert await raw(server, b"") == b""
        assert server.connections == 0
        assert crashes
