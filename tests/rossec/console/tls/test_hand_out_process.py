import asyncio
import http.client
import io
import os
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any

import pytest

from rossec.console.tls import hand_out
from rossec.console.tls.hand_out import FILE, handing_out
from rossec.errors import ConfigurationError
from rossec.host import workers
from tests.support.console_tls import new_authority
from tests.support.ports import free_port

ORIGIN = "https://rossec.local:7411"
HERE = ("127.0.0.1",)
CERTIFICATE = new_authority().data


def listening() -> socket.socket:
    return socket.create_server(("127.0.0.1", 0))


def ask(port: int, method: str = "GET", path: str = FILE) -> tuple[int, bytes, str]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    try:
        connection.request(method, path, headers={"Host": "evil.example"})
        answer = connection.getresponse()
        return answer.status, answer.read(), answer.headers.get("Server", "")
    finally:
        connection.close()


def is_closed(port: int) -> bool:
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), 5):
        return False
    return True


def test_a_process_of_its_own_hands_it_out_while_it_is_wanted() -> None:
    port = free_port()
    with handing_out(CERTIFICATE, ORIGIN, HERE, os.environ, port):
        assert ask(port) == (200, CERTIFICATE, "")
        assert ask(port, path="/")[0] == 200
        assert ask(port, "POST")[0] == 405
        assert ask(port, path="/login")[0] == 404
    assert is_closed(port)


def test_it_ends_by_itself() -> None:
    port = free_port()
    with handing_out(CERTIFICATE, ORIGIN, HERE, os.environ, port, seconds=1.0):
        end = time.monotonic() + 30
        while not is_closed(port):
            assert time.monotonic() < end
            time.sleep(0.1)


def test_a_port_in_use_is_said() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with (
            pytest.raises(ConfigurationError, match="cannot listen"),
            handing_out(CERTIFICATE, ORIGIN, HERE, os.environ, port),
        ):
            raise AssertionError


async def test_it_serves_until_its_supervisor_ends() -> None:
    reading, writing = os.pipe()
    sock = listening()
    port = sock.getsockname()[1]
    with os.fdopen(reading, "rb") as until:
        task = asyncio.ensure_future(hand_out.serve([sock], ORIGIN, 60, CERTIFICATE, until))
        assert await asyncio.to_thread(ask, port) == (200, CERTIFICATE, "")
        os.close(writing)
        await asyncio.wait_for(task, 30)
    assert is_closed(port)


async def test_it_serves_for_its_time() -> None:
    reading, writing = os.pipe()
    sock = listening()
    port = sock.getsockname()[1]
    with os.fdopen(reading, "rb") as until, os.fdopen(writing, "wb"):
        await hand_out.serve([sock], ORIGIN, 0.1, CERTIFICATE, until)
    assert is_closed(port)


def test_it_is_confined_before_it_serves(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []

    async def serve(listening: list[socket.socket], *given: object) -> None:
        done.append("served")
        assert given[:3] == (ORIGIN, 600.0, CERTIFICATE)
        for sock in listening:
            sock.close()

    def confine() -> ThreadPoolExecutor:
        done.append("processes")
        return ThreadPoolExecutor(1)

    monkeypatch.setattr(workers, "confine_files", lambda _: done.append("files"))
    monkeypatch.setattr(workers, "confine_processes", confine)
    monkeypatch.setattr(hand_out, "serve", serve)
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO()))
    descriptor = listening().detach()
    hand_out.main([str(descriptor), ORIGIN, "600", CERTIFICATE.hex()])
    assert done == ["files", "processes", "served"]


def test_one_that_does_not_end_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    sleeper = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(600)"
    real = subprocess.Popen

    def start(command: list[str], **options: Any) -> subprocess.Popen[bytes]:
        del command
        return real([sys.executable, "-c", sleeper], **options)

    monkeypatch.setattr(subprocess, "Popen", start)
    monkeypatch.setattr(hand_out, "END", 0.2)
    port = free_port()
    with handing_out(CERTIFICATE, ORIGIN, HERE, os.environ, port):
        assert not is_closed(port)
    assert is_closed(port)
