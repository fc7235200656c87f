"""The console's web process as it really runs, over a service in a thread of this one."""

import asyncio
import contextlib
import http.client
import os
import socket
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import NamedTuple

from rossec.console.server.control import WebSettings
from rossec.console.server.supervisor import PreviewProcess, WebOptions, WebProcess
from tests.support.consoleservice import FakeHome, fake_service


class Running(NamedTuple):
    """A web process: the port it serves at, its origin, what the service shows."""

    web: WebProcess
    port: int
    origin: str
    home: FakeHome


# A confined process can write no file, so it records no coverage.
UNMEASURED = {key: value for key, value in os.environ.items() if not key.startswith("COVERAGE")}


@contextlib.contextmanager
def listening() -> Iterator[socket.socket]:
    """A socket that listens at a free port of localhost."""
    with socket.create_server(("127.0.0.1", 0)) as sock:
        yield sock


@contextlib.asynccontextmanager
async def running_web(
    directory: Path,
    users: frozenset[int] | None = frozenset({os.geteuid()}),
    preview: PreviewProcess | None = None,
    **settings: object,
) -> AsyncIterator[Running]:
    """A web process that serves, ended afterwards. `directory` is for the service's socket."""
    with fake_service(directory / "console.sock") as home, listening() as sock:
        port = sock.getsockname()[1]
        origin = f"http://localhost:{port}"
        found = WebSettings("home", (origin,), users=users, **settings)  # type: ignore[arg-type]
        options = WebOptions(found, directory / "console.sock")
        web = WebProcess(options, [sock], UNMEASURED, preview=preview)
        task = asyncio.ensure_future(web.run())
        try:
            await web.started()
            yield Running(web, port, origin, home)
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


class Answer(NamedTuple):
    """Status, headers with lower-case names, body."""

    status: int
    headers: dict[str, str]
    body: str


async def ask(
    running: Running, path: str, method: str = "GET", body: str | None = None, **headers: str
) -> Answer:
    """A request as a browser at the console's address sends it; `Host=` and others replace."""

    def send() -> Answer:
        connection = http.client.HTTPConnection("127.0.0.1", running.port, timeout=20)
        given = {"Host": running.origin.removeprefix("http://"), **headers}
        with contextlib.closing(connection):
            connection.request(method, path, body, {k.replace("_", "-"): v for k, v in given.items()})
            answer = connection.getresponse()
            found = {name.lower(): text for name, text in answer.getheaders()}
            return Answer(answer.status, found, answer.read().decode())

    return await asyncio.to_thread(send)


def _as_sent(headers: dict[str, str]) -> dict[str, str]:
    return {name.replace("_", "-"): text for name, text in headers.items()}
