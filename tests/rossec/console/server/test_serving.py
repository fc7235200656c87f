"""The server: limits for connections that give no head, or too many of them."""

import asyncio
import socket
import ssl
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from rossec.console.server import serving as module
from rossec.console.server import serving as places
from rossec.console.server.serving import MAX_HEAD, PLACE, ConsoleServer
from rossec.console.server.web import load_bundle, make_context
from rossec.console.tls.certificates import key_pem
from rossec.errors import PeerUserRefused
from rossec.net.limits import HalfOpenLimits
from tests.support.console_tls import NOW, new_authority, new_key, pem

REQUEST = b"GET / HTTP/1.1\r\nHost: a\r\n\r\n"


async def hello(scope: Scope, receive: Receive, send: Send) -> None:
    await PlainTextResponse(scope["client"][0])(scope, receive, send)


@asynccontextmanager
async def serving(app: ASGIApp = hello) -> AsyncIterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as sock:
        server = ConsoleServer(app)
        await server.start([sock])
        try:
            yield sock.getsockname()[1]
        finally:
            await server.close()


async def ask(port: int, *pieces: bytes, pause: float = 0, context: ssl.SSLContext | None = None) -> bytes:
    """Send the pieces; returns what comes until the end."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=context)
    try:
        for piece in pieces:
            writer.write(piece)
            await asyncio.sleep(pause)
        async with asyncio.timeout(10):
            return await reader.read()
    except ConnectionError:
        return b""
    finally:
        writer.transport.abort()


CLOSING = REQUEST.replace(b"\r\n\r\n", b"\r\nConnection: close\r\n\r\n")


async def test_it_answers_with_a_date_and_without_its_name() -> None:
    async with serving() as port:
        head, _, body = (await ask(port, CLOSING)).partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 200 OK\r\n")
    assert b"\r\ndate: " in head
    assert b"server" not in head
    assert body == b"127.0.0.1"


async def test_headers_of_a_proxy_are_not_read() -> None:
    async with serving() as port:
        given = CLOSING.replace(b"Host: a", b"Host: a\r\nX-Forwarded-For: 192.0.2.1")
        assert (await ask(port, given)).endswith(b"127.0.0.1")


async def test_requests_follow_each_other_on_a_connection() -> None:
    async with serving() as port:
        answers = await ask(port, REQUEST, REQUEST + REQUEST, CLOSING, pause=0.05)
    assert answers.count(b"200 OK") == 4


@pytest.mark.parametrize("begun", [b"", b"GET / HT", REQUEST[:-2], REQUEST + b"GET"])
async def test_a_head_that_does_not_come_ends_the_connection(
    begun: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "HEAD_TIME", 0.05)
    async with serving() as port:
        answer = await ask(port, *[begun[place : place + 1] for place in range(len(begun))])
    assert answer.count(b"200 OK") == begun.count(REQUEST)


async def test_an_answer_may_take_longer_than_a_head(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "HEAD_TIME", 0.05)

    async def slow(scope: Scope, receive: Receive, send: Send) -> None:
        await asyncio.sleep(0.3)
        await hello(scope, receive, send)

    async with serving(slow) as port:
        assert b"200 OK" in await ask(port, CLOSING)


@pytest.mark.parametrize("data", [b"nonsense\r\n\r\n", REQUEST[:-2] + b"X: " + b"a" * MAX_HEAD])
async def test_what_cannot_be_read_is_not_answered(data: bytes) -> None:
    async with serving() as port:
        assert await ask(port, data) == b""


async def test_connections_are_bounded_for_one_address_and_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    for caps in (HalfOpenLimits(per_address=2, total=9), HalfOpenLimits(per_address=9, total=2)):
        with monkeypatch.context() as patch:
            patch.setattr(places, "STRANGERS", caps)
            async with serving() as port:
                first = [await asyncio.open_connection("127.0.0.1", port) for _ in range(2)]
                await asyncio.sleep(0.05)
                assert await ask(port, CLOSING) == b""
                for reader, writer in first:
                    writer.write(CLOSING)
                    assert b"200 OK" in await reader.read()
                    writer.transport.abort()
                assert b"200 OK" in await ask(port, CLOSING)


def server_context() -> ssl.SSLContext:
    authority, key = new_authority(), new_key()
    context = make_context()
    leaf = authority.issue(key.public_key(), now=NOW, serial=9)
    load_bundle(context, key_pem(key) + pem(leaf))
    return context


def client_context() -> ssl.SSLContext:
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    return context


def descriptors() -> int:
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


async def opened(port: int, address: str, count: int) -> list[asyncio.StreamWriter]:
    where = (address, 0)
    return [(await asyncio.open_connection("127.0.0.1", port, local_addr=where))[1] for _ in range(count)]


@pytest.mark.attack("console-connections")
@pytest.mark.parametrize("context", [None, server_context()], ids=["plain", "tls"])
async def test_two_addresses_that_hold_all_places_keep_nobody_out(context: ssl.SSLContext | None) -> None:
    """TLS that never begins is counted too: no more descriptors are held than there are places."""
    with socket.create_server(("127.0.0.1", 0)) as sock:
        port = sock.getsockname()[1]
        server = ConsoleServer(hello, context)
        await server.start([sock])
        before = descriptors()
        held = [*await opened(port, "127.0.0.2", 300), *await opened(port, "127.0.0.3", 300)]
        await until(lambda: len(server.places) == 2 * places.STRANGERS.per_address)
        ours = len(held)
        assert descriptors() - before <= ours + len(server.places) + 8
        more = [each for last in range(4, 20) for each in await opened(port, f"127.0.0.{last}", 40)]
        await until(lambda: len(server.places) == places.STRANGERS.total)
        assert b"200 OK" in await ask(port, CLOSING, context=client_context() if context else None)
        for writer in held + more:
            writer.transport.abort()
        await server.close()
        await until(lambda: len(server.places) == 0)


@pytest.mark.attack("console-connections")
async def test_strangers_end_no_connection_of_a_session() -> None:
    async def known(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["path"] == "/known":
            scope[PLACE].belongs_to("phone Anna")
        await hello(scope, receive, send)

    async with serving(known) as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(REQUEST.replace(b"GET /", b"GET /known"))
        assert b"200 OK" in await reader.readuntil(b"127.0.0.1")
        held = await opened(port, "127.0.0.1", places.STRANGERS.per_address + 9)
        for last in range(2, 9):
            held += await opened(port, f"127.0.0.{last}", 60)
        writer.write(CLOSING)
        assert b"200 OK" in await reader.read()
        for each in [writer, *held]:
            each.transport.abort()


async def until(holds: Callable[[], bool]) -> None:
    async with asyncio.timeout(20):
        while not holds():  # noqa: ASYNC110 - what it waits for tells nobody
            await asyncio.sleep(0.01)


async def test_other_users_of_the_host_take_no_place_from_its_owner(monkeypatch: pytest.MonkeyPatch) -> None:
    def check(scope: Scope, _users: object) -> None:
        if scope["client"][0] == "127.0.0.2":
            raise PeerUserRefused("another user")

    monkeypatch.setattr(module, "check_peer", check)
    monkeypatch.setattr(places, "STRANGERS", HalfOpenLimits(per_address=2, total=2))
    monkeypatch.setattr(places, "OTHER_USERS", HalfOpenLimits(per_address=3, total=3))
    async with serving() as port:
        address = ("127.0.0.2", 0)
        many = [await asyncio.open_connection("127.0.0.1", port, local_addr=address) for _ in range(9)]
        assert (await ask(port, CLOSING)).endswith(b"127.0.0.1")
        for reader, writer in many[3:]:
            with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
                await reader.readexactly(1)
            writer.transport.abort()
        many[0][1].write(CLOSING)
        assert (await many[0][0].read()).endswith(b"127.0.0.2"), "a few are told by the guard"
        for _, writer in many:
            writer.transport.abort()


async def test_no_websocket() -> None:
    upgrade = b"\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\r\n"
    async with serving() as port:
        answer = await ask(port, REQUEST.replace(b"\r\n\r\n", upgrade), CLOSING, pause=0.05)
    assert b"101" not in answer.partition(b"\r\n")[0]
