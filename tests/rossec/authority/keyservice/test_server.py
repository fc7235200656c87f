"""The service's socket: for one user, bounded, and deaf to what is malformed."""

import asyncio
import os
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from ca.encoding import Value
from rossec.authority.keyservice import messages
from rossec.authority.keyservice import process as module
from rossec.authority.keyservice.messages import ServiceRequest, write_request
from rossec.authority.keyservice.process import AuditedCaller, KeyServer, SocketRules
from rossec.errors import ConfigurationError, KeyMessageRefused, KeyServiceRefused, PeerUserRefused
from rossec.host.local_sockets import UnixPeer

STATUS = write_request(ServiceRequest("status"))


async def carry_out(request: ServiceRequest, caller: AuditedCaller) -> Value:
    if request.operation == "lock":
        raise KeyServiceRefused("not now", "later")
    if request.operation == "sign":
        raise ZeroDivisionError
    return [request.operation, caller.user, caller.process]


@pytest.fixture
async def path(tmp_path: Path) -> AsyncIterator[Path]:
    path = tmp_path / "service.sock"
    path.touch()  # as a service leaves it that was killed
    server = KeyServer(path, carry_out)
    await server.start()
    yield path
    await server.close()
    assert not path.exists()


async def answer(reader: asyncio.StreamReader) -> Value:
    async with asyncio.timeout(10):
        size = messages.frame_size(await reader.readexactly(messages.HEAD))
        return messages.read_answer(await reader.readexactly(size))


async def exchange(path: Path, data: bytes) -> Value:
    reader, writer = await asyncio.open_unix_connection(path)
    try:
        writer.write(data)
        return await answer(reader)
    finally:
        writer.close()


async def test_requests_of_one_connection_are_answered_in_order(path: Path) -> None:
    reader, writer = await asyncio.open_unix_connection(path)
    writer.write(STATUS * 3)
    for _ in range(3):
        assert await answer(reader) == ["status", os.getuid(), os.getpid()]
    for byte in STATUS:  # and one that arrives byte by byte
        writer.write(bytes((byte,)))
        await asyncio.sleep(0)
    assert await answer(reader) == ["status", os.getuid(), os.getpid()]
    writer.close()


async def test_a_refusal_does_not_end_the_connection(path: Path) -> None:
    reader, writer = await asyncio.open_unix_connection(path)
    writer.write(write_request(ServiceRequest("lock")) + STATUS)
    with pytest.raises(KeyServiceRefused, match="not now"):
        await answer(reader)
    assert await answer(reader)
    writer.close()


@pytest.mark.parametrize(
    "data",
    [
        b"\0\0\0\1\xff",
        b"\0\0\0\0",
        b"\xff\xff\xff\xff",
        b"GET / HTTP/1.0\r\n\r\n",
        messages.frame([1, "format"]),
        messages.frame([9, "status"]),
    ],
)
async def test_what_is_malformed_is_refused_and_ends_the_connection(path: Path, data: bytes) -> None:
    reader, writer = await asyncio.open_unix_connection(path)
    writer.write(data)
    with pytest.raises(KeyMessageRefused):
        await answer(reader)
    assert await reader.read() == b""
    writer.close()
    assert await exchange(path, STATUS)


async def test_a_crash_ends_one_connection(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(asyncio.IncompleteReadError):
        await exchange(path, write_request(ServiceRequest("sign", (b"x",))))
    assert "a connection to the service ended" in caplog.text
    assert await exchange(path, STATUS)


async def test_a_slow_or_silent_caller_is_dropped(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "DEADLINE", 0.05)
    monkeypatch.setattr(module, "IDLE", 0.05)
    for beginning in (b"", STATUS[:1], STATUS[:-1]):
        reader, writer = await asyncio.open_unix_connection(path)
        writer.write(beginning)
        assert await reader.read() == b""
        writer.close()


async def test_one_who_reads_no_answers_is_dropped(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "DEADLINE", 0.2)
    _, writer = await asyncio.open_unix_connection(path, limit=1)
    data = STATUS * 1000

    async def ask_on() -> None:
        while True:
            writer.write(data)
            await writer.drain()

    with pytest.raises(ConnectionError):
        await asyncio.wait_for(ask_on(), 20)
    writer.transport.abort()
    assert await exchange(path, STATUS)


async def test_callers_are_bounded(tmp_path: Path) -> None:
    path = tmp_path / "x.sock"
    server = KeyServer(path, carry_out, rules=SocketRules(max_callers=3))
    await server.start()
    others = [await asyncio.open_unix_connection(path) for _ in range(3)]
    for reader, writer in others:
        writer.write(STATUS)
        await answer(reader)
    with pytest.raises(KeyServiceRefused, match="3 programs use"):
        await exchange(path, b"")
    others[0][1].close()
    await others[0][1].wait_closed()
    await asyncio.sleep(0.05)
    assert await exchange(path, STATUS)
    for _, writer in others[1:]:
        writer.close()
    await server.close()


async def test_rules_say_what_a_request_is_and_how_long(tmp_path: Path) -> None:
    def read_request(body: bytes) -> ServiceRequest:
        return messages.read_request(body, {"nodes": ()})

    path = tmp_path / "x.sock"
    rules = SocketRules(read_request, max_request=64, users={os.getuid(), 0})
    server = KeyServer(path, carry_out, rules=rules)
    await server.start()
    assert path.stat().st_mode & 0o777 == 0o666, "another user may connect, and is looked at"
    assert await exchange(path, messages.frame([1, "nodes"])) == ["nodes", os.getuid(), os.getpid()]
    for data in (STATUS, messages.frame([1, "nodes", bytes(64)])):
        with pytest.raises(KeyMessageRefused):
            await exchange(path, data)
    await server.close()


async def test_another_user_gets_no_answer(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with pytest.raises((asyncio.IncompleteReadError, ConnectionError)):
        await exchange(path, STATUS)
    assert f"user {os.getuid()} may not use this connection" in caplog.text


async def test_a_process_that_may_not_ask_gets_no_answer(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    def admit(peer: UnixPeer) -> None:
        raise PeerUserRefused(f"process {peer.process} may not ask")

    server = KeyServer(tmp_path / "x.sock", carry_out, admit)
    await server.start()
    with pytest.raises((asyncio.IncompleteReadError, ConnectionError)):
        await exchange(tmp_path / "x.sock", STATUS)
    assert f"process {os.getpid()} may not ask" in caplog.text
    await server.close()


async def test_closing_ends_every_connection(tmp_path: Path) -> None:
    server = KeyServer(tmp_path / "x.sock", carry_out)
    await server.start()
    reader, writer = await asyncio.open_unix_connection(tmp_path / "x.sock")
    writer.write(STATUS)
    await answer(reader)
    await server.close()
    with pytest.raises((asyncio.IncompleteReadError, ConnectionError)):
        await reader.readexactly(1)
    writer.close()


async def test_a_path_that_is_too_long_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="too long"):
        await KeyServer(tmp_path / ("x" * 108), carry_out).start()
