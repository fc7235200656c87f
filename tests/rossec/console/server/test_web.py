"""The web process's own module, in this process: what it does before and while it serves."""

import asyncio
import socket
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from rossec.authority.console.client import ConsoleClient
from rossec.console.server import control
from rossec.console.server import web as module
from rossec.console.server.control import WebSettings, write_settings
from rossec.console.server.web import WebServer, main, make_context
from rossec.errors import ConfigurationError, KeyMessageRefused
from rossec.host import workers
from tests.support.consoleprocess import listening

SETTINGS = WebSettings("home", ("http://localhost:7411",))


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    ours, theirs = socket.socketpair()
    ours.settimeout(20)
    yield ours, theirs
    ours.close()
    theirs.close()


@pytest.fixture
def scanner() -> Iterator[socket.socket]:
    """The web process's end of a socketpair, at whose other end nobody reads pictures."""
    end, other = socket.socketpair()
    with end, other:
        yield end


@pytest.fixture
def web(tmp_path: Path, scanner: socket.socket) -> WebServer:
    return WebServer(SETTINGS, ConsoleClient(tmp_path / "no.sock"), scanner)


def said(ours: socket.socket) -> control.ControlMessage:
    size = int.from_bytes(ours.recv(4))
    return control.read(ours.recv(size))


async def test_it_says_that_it_serves_and_ends_with_its_supervisor(
    web: WebServer, pair: tuple[socket.socket, socket.socket]
) -> None:
    ours, theirs = pair
    with listening() as sock:
        running = asyncio.ensure_future(web.run(theirs, [sock]))
        assert await asyncio.to_thread(said, ours) == control.ControlMessage(control.READY)
        reader, writer = await asyncio.open_connection(*sock.getsockname())
        writer.write(b"GET /login HTTP/1.1\r\nHost: localhost:7411\r\nConnection: close\r\n\r\n")
        assert b"200 OK" in await reader.read()
        writer.close()
        ours.close()
        await asyncio.wait_for(running, 10)


@pytest.mark.parametrize(
    ("sent", "error"),
    [
        (control.write(control.ControlMessage(control.READY)), ConfigurationError),
        (control.write(control.ControlMessage(control.CERTIFICATE, (b"",))), ConfigurationError),
        (b"\0\0\0\1\xff", KeyMessageRefused),
        (b"\xff\xff\xff\xff", KeyMessageRefused),
    ],
)
async def test_a_supervisor_that_says_something_else_is_none(
    web: WebServer, pair: tuple[socket.socket, socket.socket], sent: bytes, error: type[Exception]
) -> None:
    ours, theirs = pair
    with listening() as sock:
        ours.send(sent)
        with pytest.raises(error):
            await web.run(theirs, [sock])


async def test_with_tls_it_waits_for_a_certificate(
    tmp_path: Path, scanner: socket.socket, pair: tuple[socket.socket, socket.socket]
) -> None:
    ours, theirs = pair
    client = ConsoleClient(tmp_path / "no.sock")
    process = WebServer(SETTINGS, client, scanner, make_context())
    ours.send(control.write(control.ControlMessage(control.CERTIFICATE, (b"no certificate",))))
    with listening() as sock, pytest.raises(ConfigurationError):
        await process.run(theirs, [sock])


async def test_it_is_confined_before_it_serves(
    tmp_path: Path,
    scanner: socket.socket,
    pair: tuple[socket.socket, socket.socket],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    done: list[str] = []

    def confine() -> ThreadPoolExecutor:
        done.append("processes")
        return ThreadPoolExecutor(1)

    monkeypatch.setattr(module, "protect_memory", lambda: done.append("memory"))
    monkeypatch.setattr(workers, "confine_files", lambda paths: done.append(f"files {paths}"))
    monkeypatch.setattr(workers, "confine_processes", confine)
    ours, theirs = pair
    with socket.create_server(("127.0.0.1", 0)) as sock:
        given = [theirs.detach(), scanner.detach(), sock.detach()]
    arguments = [write_settings(SETTINGS), str(tmp_path / "no.sock"), "plain", "text", "made-up"]
    running = asyncio.ensure_future(asyncio.to_thread(main, [",".join(map(str, given)), *arguments]))
    assert await asyncio.to_thread(said, ours) == control.ControlMessage(control.READY)
    assert done == ["memory", "files ()", "processes"]
    ours.close()
    await asyncio.wait_for(running, 20)
