"""The web process: serves, is confined, is started again, ends with its supervisor."""

import asyncio
import os
import signal
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from rossec.console.app import HEADERS
from rossec.console.server import supervisor as module
from rossec.console.server.control import WebSettings
from rossec.console.server.supervisor import WebOptions, WebProcess
from rossec.errors import ConfigurationError
from tests.support.consoleprocess import UNMEASURED, ask, listening, running_web
from tests.support.serviceprocess import children_of, wait_until_gone


def read_proc(pid: int, name: str) -> str:
    return Path(f"/proc/{pid}/{name}").read_text()


def limit_of(pid: int, name: str) -> list[str]:
    """The soft and the hard limit."""
    (line,) = [line for line in read_proc(pid, "limits").splitlines() if line.startswith(name)]
    return line.removeprefix(name).split()[:2]


async def test_it_serves_pages_with_every_header(tmp_path: Path) -> None:
    async with running_web(tmp_path) as running:
        answer = await ask(running, "/login")
        assert answer.status == 200
        for name, text in HEADERS.items():
            assert answer.headers[name.lower()] == text
        assert "server" not in answer.headers
        assert "date" in answer.headers


async def test_a_code_logs_in_and_shows_what_the_service_has(tmp_path: Path) -> None:
    async with running_web(tmp_path) as running:
        code = f"code={running.home.add_code()}"
        form = {"Origin": running.origin, "Content_Type": "application/x-www-form-urlencoded"}
        answer = await ask(running, "/login", "POST", code, **form)
        assert answer.status == 303
        cookie = answer.headers["set-cookie"].partition(";")[0]
        page = await ask(running, "/phones", Cookie=cookie)
        assert page.status == 200
        assert "Ben&#39;s phone" in page.body


async def test_it_is_confined(tmp_path: Path) -> None:
    async with running_web(tmp_path) as running:
        pid = running.web.pid
        assert pid is not None
        await ask(running, "/login")
        assert limit_of(pid, "Max processes") == ["0", "0"]
        assert children_of(pid) == []
        assert "NoNewPrivs:\t1" in read_proc(pid, "status")


async def test_it_is_started_again_at_the_same_port(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    async with running_web(tmp_path) as running:
        first = running.web.pid
        assert first is not None
        os.kill(first, signal.SIGKILL)
        async with asyncio.timeout(30):
            answer = await ask(running, "/login")
        assert answer.status == 200
        assert running.web.pid != first
    assert "the web process ended; it is started again" in caplog.text


async def test_it_ends_with_its_supervisor(tmp_path: Path) -> None:
    async with running_web(tmp_path) as running:
        pid = running.web.pid
        assert pid is not None
    wait_until_gone(pid)


async def test_one_that_does_not_start_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "START", 0.01)
    settings = WebSettings("home", ("http://localhost:1",))
    with listening() as sock:
        web = WebProcess(WebOptions(settings, tmp_path / "no"), [sock], UNMEASURED, module="no")
        with pytest.raises(ConfigurationError, match="does not start"):
            await web.started()
        task = asyncio.ensure_future(web.run())
        await asyncio.sleep(0.5)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        assert web.pid is None


async def test_one_that_breaks_the_protocol_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(module, "END", 0.1)
    given: list[bytes] = []

    async def certificates(install: Callable[[bytes], Awaitable[None]]) -> None:
        await install(b"bundle")
        given.append(b"bundle")
        await asyncio.Event().wait()

    options = WebOptions(WebSettings("home", ("https://localhost:1",)), tmp_path / "no")
    with listening() as sock:
        web = WebProcess(options, [sock], UNMEASURED, certificates, "tests.support.takenweb")
        task = asyncio.ensure_future(web.run())
        async with asyncio.timeout(30):
            while "it is started again" not in caplog.text:  # noqa: ASYNC110 - a log has no event
                await asyncio.sleep(0.05)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    assert "breaks the protocol: the web process says what is not for it to say" in caplog.text
    assert given == [b"bundle"]
