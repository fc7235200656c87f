"""The asyncio shell: clients and servers over real sockets on loopback."""

import asyncio
import contextlib
import dataclasses
import errno
import gc
import logging
import socket
import weakref
from collections.abc import AsyncIterator

import pytest

from rossec.channel.edhoc.known import KnownCertificates
from rossec.channel.edhoc.suites import POST_QUANTUM
from rossec.channel.opening import REFUSAL, WireProtocol
from rossec.channel.records import ChannelLimits
from rossec.errors import (
    ChannelClosed,
    ChannelError,
    ConnectionTruncated,
    HandshakeFailed,
    IdentityExpired,
    IdentityRefused,
    LimitExceeded,
    PeerRefused,
    PeerUnreachable,
    PlainPeer,
    SendQueueFull,
)
from rossec.net.aio import HalfOpen, SecureServer, SecureStream, connect, serve
from rossec.net.aio import driver as driver_module
from rossec.net.aio import server as server_module
from rossec.net.aio import stream as secure_module
from rossec.net.aio.server import bind
from rossec.net.aio.tasks import TaskSet
from rossec.net.aio.transport import Transport
from rossec.net.halfopen import source_of
from tests.support.wire import ALICE, BOB, STRANGER, FakeIdentity, trust

Stream = SecureStream[FakeIdentity]
LIVE = 1 << 40  # a not_after which the host's clock does not reach


def live(chain: tuple[bytes, ...], now: int) -> FakeIdentity:
    found = trust(chain, now)
    return FakeIdentity(found.name, found.public_key, found.certificate, LIVE)


async def echo(stream: Stream) -> None:
    while True:
        await stream.send(await stream.receive())


@pytest.fixture
async def server() -> AsyncIterator[SecureServer[FakeIdentity]]:
    async with serve(echo, "127.0.0.1", 0, BOB, live) as running:
        yield running


async def call(
    server: SecureServer[FakeIdentity], opening: WireProtocol = WireProtocol.TCPROS
) -> Stream:
    return await connect("127.0.0.1", server.port, ALICE, live, opening=opening)


async def still_works(server: SecureServer[FakeIdentity]) -> None:
    async with await call(server) as stream:
        await stream.send(b"ping")
        assert await stream.receive() == b"ping"


@pytest.mark.parametrize("opening", list(WireProtocol))
@pytest.mark.parametrize("size", [1, 70_000, 3_000_000])
async def test_units_there_and_back(
    server: SecureServer[FakeIdentity], opening: WireProtocol, size: int
) -> None:
    async with await call(server, opening) as stream:
        assert stream.peer.name == "/bob"
        assert stream.opening is opening
        assert stream.address == "127.0.0.1"
        await stream.send(b"x" * size, b"tail")
        assert await stream.receive() == b"x" * size + b"tail"
    with pytest.raises(ChannelClosed):
        await stream.receive()
    with pytest.raises(ChannelClosed):
        await stream.send(b"late")
    with pytest.raises(ChannelClosed):
        stream.send_nowait(b"late")


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost"])
async def test_both_families_on_one_port(host: str) -> None:
    async with serve(echo, None, 0, BOB, live) as server:
        stream = await connect(host, server.port, ALICE, live)
        await stream.send(b"x")
        assert await stream.receive() == b"x"
        await stream.close()


async def test_nothing_waits_for_nagle(server: SecureServer[FakeIdentity]) -> None:
    async with await call(server) as stream:
        for driver in (stream._driver, *server._drivers):
            sock = driver.transport.socket
            assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


async def test_small_units_queued_together_arrive_together(
    server: SecureServer[FakeIdentity],
) -> None:
    async with await call(server) as stream:
        for count in range(100):
            stream.send_nowait(b"%02d" % count, b";")
        assert stream.backlog == 300
        unit = await stream.receive()
        assert unit == b"".join(b"%02d;" % count for count in range(100))
        stream.send_nowait(b"first ")
        await stream.send(b"second")
        assert await stream.receive() == b"first second"


async def test_what_is_said_at_once_travels_with_the_last_flight(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    written: dict[Transport, list[bool]] = {}
    write = Transport.write

    def note(self: Transport, data: bytes) -> None:
        written.setdefault(self, []).append(len(data) > 1000)
        write(self, data)

    monkeypatch.setattr(Transport, "write", note)
    async with serve(echo, "127.0.0.1", 0, BOB, live) as server:
        stream = await call(server)
        await stream.send(b"x" * 1000)
        assert await stream.receive() == b"x" * 1000
        stream.abort("done")
    assert list(written.values()) == [[False, True], [False, True]]


async def test_who_says_nothing_still_finishes_the_handshake() -> None:
    async with serve(greet, "127.0.0.1", 0, BOB, live) as server:
        stream = await call(server)
        assert await stream.receive() == b"welcome"
        stream.abort("done")


async def greet(stream: Stream) -> None:
    await stream.send(b"welcome")
    await stream.wait_ended()


async def test_a_connection_that_ended_holds_nothing() -> None:
    ended: list[weakref.ref[object]] = []

    async def serving(stream: Stream) -> None:
        ended.append(weakref.ref(stream._driver))
        await echo(stream)

    async with serve(serving, "127.0.0.1", 0, BOB, live) as server:
        gc.collect()
        gc.disable()  # or it might do the work
        try:
            stream = await call(server)
            ended.append(weakref.ref(stream._driver))
            await stream.send(b"x")
            await stream.receive()
            await stream.close()
            with pytest.raises(ChannelClosed):
                await stream.receive()
            del stream
            while any(each() is not None for each in ended):  # noqa: ASYNC110 - nobody tells
                await asyncio.sleep(0.001)
        finally:
            gc.enable()
    assert len(ended) == 2


async def test_a_burst_is_joined_after_its_first_unit(
    server: SecureServer[FakeIdentity], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 1000.0
    monkeypatch.setattr(secure_module, "monotonic", lambda: now)
    async with await call(server) as stream:
        for unit in (b"alone", b"and ", b"the ", b"others"):
            await stream.send(unit)
        assert stream.backlog == len(b"and the others")
        assert await stream.receive() == b"alone"
        assert await stream.receive() == b"and the others"
        now += 1
        await stream.send(b"later")
        assert stream.backlog == 0
        assert await stream.receive() == b"later"


async def test_a_unit_alone_is_offered_before_it_is_kept(
    server: SecureServer[FakeIdentity],
) -> None:
    async with await call(server) as stream:
        told, offered = asyncio.Event(), list[bytes]()

        def take(unit: bytes) -> bool:
            offered.append(unit)
            told.set()
            return unit != b"kept"

        stream.on_ready(told.set, take)
        for unit in (b"taken", b"kept", b"behind"):
            await stream.send(unit)
            await asyncio.wait_for(told.wait(), 10)
            told.clear()
        assert offered == [b"taken", b"kept"]
        assert (stream.next_unit(), stream.next_unit()) == (b"kept", b"behind")
        assert stream.next_unit() is None


async def test_a_slow_reader_stops_the_writer() -> None:
    go = asyncio.Event()
    got = 0

    async def slow(stream: Stream) -> None:
        nonlocal got
        await go.wait()
        while True:
            got += len(await stream.receive())

    async with serve(slow, "127.0.0.1", 0, BOB, live) as server:
        stream = await call(server)
        lags = [stream.lags]
        sent = 0
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(1):
                while True:
                    await asyncio.shield(asyncio.ensure_future(stream.send(b"x" * 500_000)))
                    sent += 500_000
        assert sent < 64_000_000
        assert [*lags, stream.lags] == [False, True]
        with pytest.raises(SendQueueFull):  # noqa: PT012 - fills whatever is left
            while True:
                stream.send_nowait(b"y" * 10_000)
        backlog = stream.backlog
        go.set()
        await stream.send(b"z")
        await stream.close()
        await asyncio.sleep(0.1)
        assert got == sent + 500_000 + backlog + 1


async def test_a_send_given_up_half_way_ends_the_connection() -> None:
    async def deaf(stream: Stream) -> None:
        await asyncio.sleep(60)

    async with serve(deaf, "127.0.0.1", 0, BOB, live) as server:
        stream = await call(server)
        await stream.send(b"x" * 3_000_000)  # more than the peer takes unread: it stops reading
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.5):
                await stream.send(b"x" * 100_000_000)
        with pytest.raises(ChannelClosed, match="half-way"):
            await stream.send(b"y")


async def test_a_crashing_handler_ends_only_its_connection(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def picky(stream: Stream) -> None:
        unit = await stream.receive()
        await stream.send(bytes([100 // unit[0]]))
        await echo(stream)

    async with serve(picky, "127.0.0.1", 0, BOB, live) as server:
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
    server = serve(echo, "127.0.0.1", 0, BOB, live)
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


async def test_an_abort_is_a_truncation_for_the_peer(server: SecureServer[FakeIdentity]) -> None:
    stream = await call(server)
    stream.abort("revoked")
    with pytest.raises(ChannelClosed, match="revoked"):
        await stream.receive()
    with contextlib.suppress(ZeroDivisionError):
        async with await call(server) as other:
            raise ZeroDivisionError
    with pytest.raises(ChannelClosed, match="failed"):
        await other.receive()
    await still_works(server)


# -- identities


async def test_a_stranger_is_refused_on_either_side(server: SecureServer[FakeIdentity]) -> None:
    stream = await connect("127.0.0.1", server.port, STRANGER, live)
    with pytest.raises(PeerRefused):
        await stream.receive()
    async with serve(echo, "127.0.0.1", 0, STRANGER, live) as false:
        with pytest.raises(IdentityRefused):
            await call(false)
    await still_works(server)


async def test_a_certificate_that_runs_out_ends_the_connection() -> None:
    def short(chain: tuple[bytes, ...], now: int) -> FakeIdentity:
        found = trust(chain, now)
        return FakeIdentity(found.name, found.public_key, found.certificate, now + 1)

    async with serve(echo, "127.0.0.1", 0, BOB, short) as server:
        stream = await connect("127.0.0.1", server.port, ALICE, short)
        with pytest.raises((IdentityExpired, ConnectionTruncated)):
            await stream.receive()


# -- those who do not speak it


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


async def test_calling_a_plain_server() -> None:
    async def plain(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(100)
        writer.write(b"\x10\0\0\0\x0c\0\0\0error=go off")
        writer.close()

    async with await asyncio.start_server(plain, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        with pytest.raises(PlainPeer, match="go off"):
            await connect("127.0.0.1", port, ALICE, live)


async def test_the_handshake_deadline(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    limits = ChannelLimits(handshake_seconds=1)
    async with serve(echo, "127.0.0.1", 0, BOB, live, limits=limits) as server:
        stream = await call(server)
        assert await raw(server, b"\x0c\0\0") == b""
        assert "did not finish the handshake in time" in caplog.text
        await stream.send(b"x")
        assert await stream.receive() == b"x"
        await stream.close()


@pytest.mark.parametrize("caps", [HalfOpen(per_address=3), HalfOpen(total=3)])
async def test_half_open_caps_spare_the_others(caps: HalfOpen) -> None:
    async with serve(echo, "127.0.0.1", 0, BOB, live, half_open=caps) as server:
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


# -- small parts


async def test_a_caller_that_is_gone_at_once_gives_its_place_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    only = HalfOpen(total=1)
    async with serve(echo, "127.0.0.1", 0, BOB, live, half_open=only) as server:
        gone: list[str] = []

        def broken(*_: object) -> None:
            gone.append("reset")
            raise OSError(errno.EINVAL, "reset")

        with monkeypatch.context() as patch:
            patch.setattr(server_module, "Driver", broken)
            with contextlib.suppress(OSError):
                assert await raw(server, b"") == b""
        assert gone
        await still_works(server)


async def test_the_end_of_the_socket_is_told() -> None:
    async with serve(echo, "127.0.0.1", 0, BOB, live) as server:
        stream = await call(server)
        told: list[str] = []
        stream.when_closed(lambda: told.append("then"))
        await stream.close()
        stream.when_closed(lambda: told.append("later"))
        assert told == ["then", "later"]


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


async def test_a_task_set_cancels_what_still_runs() -> None:
    tasks = TaskSet()
    running = tasks.spawn(asyncio.sleep(60), name="sleeper")
    assert len(tasks) == 1
    await tasks.close()
    assert running.cancelled()
    assert len(tasks) == 0


async def test_a_peer_that_does_not_answer_the_close_is_cut_off(
    server: SecureServer[FakeIdentity], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver_module, "_LINGER", 0.1)
    stream = await call(server)
    await stream.send(b"x")
    await stream.receive()
    (there,) = server._drivers
    there.transport.pause_reading()
    closing = asyncio.get_running_loop().create_task(stream.close())
    await asyncio.sleep(0)
    stream._driver._on_timer()  # a timer that was set for something earlier
    assert not stream._driver.transport.closed
    async with asyncio.timeout(30):
        await closing
    assert stream._driver.transport.closed


# -- references to certificates, and the hybrid suite


async def test_the_second_connection_names_certificates() -> None:
    ours, theirs = KnownCertificates(), KnownCertificates()
    async with serve(echo, "127.0.0.1", 0, BOB, live, known=theirs) as server:
        for count in range(2):
            stream = await connect("127.0.0.1", server.port, ALICE, live, known=ours)
            await stream.send(b"x")
            assert await stream.receive() == b"x"
            await stream.close()
            assert stream._driver.connection._negotiation._edhoc.send_x5t == (count == 1)
        theirs._chains.clear()  # forgotten: refused with error 3, called again by value
        async with await connect("127.0.0.1", server.port, ALICE, live, known=ours) as stream:
            await stream.send(b"x")
            assert await stream.receive() == b"x"


async def test_a_hash_that_leads_astray_is_called_again_by_value() -> None:
    ours, theirs = KnownCertificates(), KnownCertificates()
    async with serve(echo, "127.0.0.1", 0, BOB, live, known=theirs) as server:
        for _ in range(3):
            stream = await connect("127.0.0.1", server.port, ALICE, live, known=ours)
            await stream.send(b"x")
            assert await stream.receive() == b"x"
            await stream.close()
            theirs._chains.update(dict.fromkeys(theirs._chains, STRANGER.chain))
        thief = dataclasses.replace(ALICE, signer=STRANGER.signer)
        stream = await connect("127.0.0.1", server.port, thief, live, known=ours)
        with pytest.raises(PeerRefused):  # by value as well
            await stream.receive()


async def test_the_hybrid_suite_by_policy() -> None:
    suites = POST_QUANTUM["require"]
    async with serve(echo, "127.0.0.1", 0, BOB, live, suites=suites) as server:
        stream = await connect("127.0.0.1", server.port, ALICE, live, suites=suites)
        await stream.send(b"x")
        assert await stream.receive() == b"x"
        await stream.close()
        with pytest.raises(HandshakeFailed):
            await call(server)


# -- the queue of small units


async def test_units_that_came_while_a_large_one_waited() -> None:
    async def count(stream: Stream) -> None:
        await asyncio.sleep(0.1)
        got = 0
        while got < 20_000_005:
            got += len(await stream.receive())
        await stream.send(b"all")

    async with serve(count, "127.0.0.1", 0, BOB, live) as server:
        stream = await call(server)
        large = asyncio.ensure_future(stream.send(bytes(20_000_000)))
        await asyncio.sleep(0.01)
        stream.send_nowait(b"small")
        await large
        assert await stream.receive() == b"all"
        stream.abort("done")


async def test_a_unit_limit_below_what_is_joined() -> None:
    limits = ChannelLimits(unit=10)
    async with serve(echo, "127.0.0.1", 0, BOB, live, limits=limits) as server:
        stream = await connect("127.0.0.1", server.port, ALICE, live, limits=limits)
        for _ in range(5):
            stream.send_nowait(b"1234567")
            await stream.send(memoryview(b"89"), b"")
        with pytest.raises(LimitExceeded):
            stream.send_nowait(b"x" * 11)
        with pytest.raises(LimitExceeded):
            await stream.send(b"x" * 11)
        got = b""
        while len(got) < 45:
            got += await stream.receive()
        assert got == b"123456789" * 5
        stream.send_nowait()
        await stream.close()


async def test_a_peer_that_does_not_follow_a_renewal_ends_the_queue() -> None:
    limits = ChannelLimits(records=1)
    async with serve(echo, "127.0.0.1", 0, BOB, live) as server:
        stream = await connect("127.0.0.1", server.port, ALICE, live, limits=limits)
        stream._driver.transport.pause_reading()
        with pytest.raises(LimitExceeded, match="renewal"):  # noqa: PT012 - some sends
            for _ in range(9):
                await stream.send(b"x")
                await asyncio.sleep(0)
        with pytest.raises(LimitExceeded):
            await stream.receive()


# -- the server and the driver at the edge


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
    monkeypatch.setattr(server_module, "_ACCEPT_PAUSE", 0.01)
    async with serve(echo, "127.0.0.1", 0, BOB, live) as server:
        await still_works(server)
    assert "too many open files" in caplog.text
    closed = socket.socket()
    closed.close()
    server._add_reader(closed)  # nothing to watch, nothing happens


async def test_addresses_are_those_of_the_connection(server: SecureServer[FakeIdentity]) -> None:
    stream = await call(server)
    assert stream.local_address == "127.0.0.1"
    stream.abort("done")
    assert stream.local_address == ""


async def test_keys_are_renewed_by_the_clock() -> None:
    limits = ChannelLimits(seconds=1)
    async with serve(echo, "127.0.0.1", 0, BOB, live, limits=limits) as server:
        stream = await connect("127.0.0.1", server.port, ALICE, live, limits=limits)
        for _ in range(2):
            await stream.send(b"x")
            assert await stream.receive() == b"x"
            await asyncio.sleep(1.2)
        assert stream._driver.connection._open_session().receive_epoch >= 1
        await stream.close()


async def test_small_units_wait_for_a_peer_that_lags() -> None:
    go = asyncio.Event()

    async def late(stream: Stream) -> None:
        await go.wait()
        got = b""
        while not got.endswith(b"end"):
            got = (got + await stream.receive())[-3:]
        await stream.send(b"all")

    async with serve(late, "127.0.0.1", 0, BOB, live) as server:
        stream = await call(server)
        while stream._driver.writable:
            await stream.send(b"x" * 1000)
        stream.send_nowait(b"y")
        await asyncio.sleep(0)
        stream.send_nowait(b"end")
        go.set()
        assert await stream.receive() == b"all"
        stream.abort("done")


async def forwarded_from(server: SecureServer[FakeIdentity], sink: list[bytes]) -> None:
    """Everything that comes back, with a receiver that lags after each."""
    async with await call(server) as stream:
        await stream.drain()
        for number in range(20):
            assert stream.write_nowait(bytes([number]) * 1000)

        def write_nowait(unit: bytes) -> bool:
            sink.append(unit)
            return False

        async def drain() -> None:
            await asyncio.sleep(0)
            if sum(map(len, sink)) == 20_000:
                await stream.close()

        await stream.forward(write_nowait, drain)


async def test_what_is_poured_comes_in_order(server: SecureServer[FakeIdentity]) -> None:
    sink: list[bytes] = []
    with pytest.raises(ChannelClosed):
        await forwarded_from(server, sink)
    assert b"".join(sink) == b"".join(bytes([number]) * 1000 for number in range(20))


async def test_a_receiver_that_fails_ends_the_pouring(server: SecureServer[FakeIdentity]) -> None:
    async with await call(server) as stream:

        def write_nowait(_: bytes) -> bool:
            raise ArithmeticError

        forwarding = asyncio.ensure_future(stream.forward(write_nowait, stream.drain))
        await asyncio.sleep(0)
        stream.write_nowait(b"x")
        with pytest.raises(ArithmeticError):
            await forwarding
    with pytest.raises(ChannelClosed):
        stream.write_nowait(b"late")
