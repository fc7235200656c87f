"""The administrator's port: for this user alone, one request, one answer."""

import asyncio
import contextlib
import logging
import os
import socket
import stat
from collections.abc import AsyncIterator, Mapping
from pathlib import Path

import pytest

from rossec.errors import ConfigurationError, PeerUserRefused
from rossec.master.operation import admin as module
from rossec.master.operation.admin import AdminPort, send_command


def answer() -> Mapping[str, object]:
    return {"calls": 5}


@pytest.fixture
async def path(tmp_path: Path) -> AsyncIterator[Path]:
    path = tmp_path / "admin.sock"
    port = AdminPort(path, {"status": answer})
    await port.start()
    yield path
    await port.close()
    assert not path.exists()


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


async def test_the_user_of_the_master_is_answered(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "rossec.audit")
    assert mode(path) == 0o600
    assert await asyncio.to_thread(send_command, path, "status") == {"calls": 5}
    assert f"user {os.getuid()} asks for status" in caplog.text
    with pytest.raises(ConfigurationError, match="refused"):
        await asyncio.to_thread(send_command, path, "format the disk")


async def test_another_user_gets_no_answer(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*_: object) -> int:
        raise PeerUserRefused("user 7 may not use this connection")

    monkeypatch.setattr(module, "require_user", refuse)
    with pytest.raises(ConfigurationError, match=r"does not answer|refused"):
        await asyncio.to_thread(send_command, path, "status")
    assert "refused at the administrator's port: user 7" in caplog.text


def exchange(path: Path, data: bytes) -> bytes:
    with socket.socket(socket.AF_UNIX) as sock:
        sock.connect(str(path))
        sock.sendall(data)
        sock.shutdown(socket.SHUT_WR)
        return sock.recv(100)


@pytest.mark.parametrize(
    "data", [b"", b"x\n", b'"status"', b"\xff\n", b"[" * 5000 + b"\n", b"[" * 1020 + b"\n"]
)
async def test_garbage_ends_the_connection(path: Path, data: bytes) -> None:
    with contextlib.suppress(ConnectionError):
        assert await asyncio.to_thread(exchange, path, data) == b""
    assert await asyncio.to_thread(send_command, path, "status") == {"calls": 5}


async def test_a_silent_connection_is_closed(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "DEADLINE", 0.05)
    reader, writer = await asyncio.open_unix_connection(path)
    assert await reader.read() == b""
    writer.close()


async def test_only_one_master_listens_and_a_stale_socket_is_replaced(path: Path) -> None:
    with pytest.raises(ConfigurationError, match="another program"):
        await AdminPort(path, {}).start()
    left = path.with_name("left.sock")
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(left))
    port = AdminPort(left, {"status": answer})
    await port.start()
    assert await asyncio.to_thread(send_command, left, "status") == {"calls": 5}
    await port.close()


def test_a_command_without_a_running_master_fails(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="does not answer") as caught:
        send_command(tmp_path / "admin.sock", "status")
    assert "--admin" in caught.value.hint


async def test_a_path_too_long_for_a_socket_is_reported(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="too long for the path of a socket") as caught:
        await AdminPort(tmp_path / ("d" * 108), {}).start()
    assert "ROSSEC_HOME" in caught.value.hint
