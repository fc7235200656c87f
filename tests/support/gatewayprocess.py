"""`rossec gateway` as a process on a host of a mesh (`tests.support.mesh`)."""

import asyncio
import contextlib
import json
import signal
from collections.abc import AsyncIterator, Iterator
from typing import Any

from tests.support.mesh import Place
from tests.support.witness import until


class GatewayProcess:
    """A gateway of a place, which is started, killed and started again."""

    def __init__(self, place: Place, words: tuple[str, ...], name: str) -> None:
        self.place, self.name = place, name
        self._words = words
        self._log = place.directory / f"{name.strip('/').replace('/', '.')}.log"
        self._process: asyncio.subprocess.Process | None = None

    async def start(self) -> None:
        """Start it, and wait until it runs."""
        before = self.said().count("ready")
        command = self.place.rossec("gateway", "--name", self.name, "--json", *self._words)
        with self._log.open("ab") as log:
            process = self._process = await asyncio.create_subprocess_exec(
                *command, env=self.place.environ, stdin=asyncio.subprocess.DEVNULL, stdout=log, stderr=log
            )

        def up() -> bool:
            assert process.returncode is None, self.said()
            return self.said().count("ready") > before

        await until(up, within=40)

    async def kill(self, number: signal.Signals = signal.SIGKILL) -> None:
        """End it."""
        assert self._process is not None
        self._process.send_signal(number)
        await self._process.wait()

    @contextlib.contextmanager
    def paused(self) -> Iterator[None]:
        """It is stopped meanwhile, as on a host that is overloaded."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self._process.send_signal(signal.SIGCONT)

    def said(self) -> str:
        """What it has printed and logged."""
        return self._log.read_text() if self._log.exists() else ""

    async def status(self) -> dict[str, Any]:
        """What `rossec gateway status` says."""
        told: dict[str, Any] = json.loads(
            await self.place.run("gateway", "--name", self.name, "status", "--json")
        )
        return told

    async def close(self) -> None:
        if self._process is not None and self._process.returncode is None:
            await self.kill()
        assert "Traceback" not in self.said(), self.said()


@contextlib.asynccontextmanager
async def gateway_of(place: Place, *words: str, name: str = "/gateway") -> AsyncIterator[GatewayProcess]:
    """A gateway that runs; `words`: what it shall serve."""
    made = GatewayProcess(place, words, name)
    try:
        await made.start()
        yield made
    finally:
        await made.close()
