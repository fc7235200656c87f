import asyncio
import os
import socket
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from rossec.enrollment import enroll
from rossec.enrollment.enroll import Answer
from rossec.errors import ConfigurationError


@asynccontextmanager
async def serving(directory: Path, answer: Callable[[Answer], Answer]) -> AsyncIterator[None]:
    server = await enroll.serve(directory, answer)
    try:
        yield
    finally:
        server.close()
        enroll.remove(directory)


async def ask(directory: Path, request: Answer) -> Answer:
    return await asyncio.to_thread(enroll.ask, directory, request)


def deep(root: Path) -> Path:
    """A directory whose path is longer than that of any Unix socket."""
    directory = root.joinpath(*["a" * 50] * 4)
    directory.mkdir(parents=True)
    return directory


async def test_a_request_is_answered(tmp_path: Path) -> None:
    directory = deep(tmp_path)
    async with serving(directory, lambda request: {"you said": request["do"]}):
        assert await ask(directory, {"do": "show"}) == {"you said": "show"}
    with pytest.raises(ConfigurationError, match="no enrollment of this node is waiting"):
        await ask(directory, {})


def test_nobody_is_waiting(tmp_path: Path) -> None:
    for directory in (tmp_path, tmp_path / "missing"):
        with pytest.raises(ConfigurationError, match="no enrollment of this") as caught:
            enroll.ask(directory, {})
        assert "rossec node enroll" in caught.value.hint


async def test_a_refusal_arrives_with_its_hint(tmp_path: Path) -> None:
    def refuse(_: Answer) -> Answer:
        raise ConfigurationError("no", "try again")

    async with serving(tmp_path, refuse):
        with pytest.raises(ConfigurationError, match="no") as caught:
            await ask(tmp_path, {})
        assert caught.value.hint == "try again"


async def test_only_one_waits(tmp_path: Path) -> None:
    async with serving(tmp_path, lambda _: {}):
        with pytest.raises(ConfigurationError, match="is waiting already"):
            await enroll.serve(tmp_path, lambda _: {})
        assert await ask(tmp_path, {}) == {}


async def test_a_stale_socket_is_replaced(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as left, enroll._socket_path(tmp_path) as path:
        left.bind(path)
    assert (tmp_path / "enrolling.sock").exists()
    async with serving(tmp_path, lambda _: {"new": "one"}):
        assert await ask(tmp_path, {}) == {"new": "one"}


async def say(directory: Path, line: bytes) -> bytes:
    with enroll._socket_path(directory) as path:
        reader, writer = await asyncio.open_unix_connection(path)
    writer.write(line)
    try:
        return await reader.read()
    finally:
        writer.close()


@pytest.mark.parametrize("line", [b"garbage\n", b"[]\n", b"\n", b"x" * 5000 + b"\n"])
async def test_a_malformed_request_gets_no_answer(tmp_path: Path, line: bytes) -> None:
    async with serving(tmp_path, lambda _: {}):
        assert await say(tmp_path, line) == b""
        assert await ask(tmp_path, {}) == {}


async def test_another_user_gets_no_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel says who calls; here it says that a stranger does."""
    stranger = struct.pack("3i", 1, os.getuid() + 4711, 4711)
    monkeypatch.setattr("socket.socket.getsockopt", lambda *_: stranger)
    monkeypatch.setattr("asyncio.trsock.TransportSocket.getsockopt", lambda *_: stranger)
    async with serving(tmp_path, lambda _: {"secret": "digits"}):
        with pytest.raises(ConfigurationError, match="has just ended"):
            await ask(tmp_path, {})
