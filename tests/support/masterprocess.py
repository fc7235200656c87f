"""`rossec master` as a separate process, on a site with its files on disk."""

import asyncio
import contextlib
import os
import socket
import sys
from collections.abc import AsyncIterator, Mapping
from pathlib import Path

from rossec.ros.names import MASTER
from tests.support.ports import free_port
from tests.support.site import Site
from tests.support.witness import until


class MasterProcess:
    """Starts, kills and restarts the master of `site` on one port."""

    def __init__(self, site: Site) -> None:
        self.site = site
        self.port = free_port()
        self.log = site.root / "master.log"
        self.process: asyncio.subprocess.Process | None = None
        home = site.enroll(MASTER)
        if home.load_revocations() is None:
            home.save_revocations(site.authority.store.newest_list() or b"")

    @property
    def uri(self) -> str:
        return f"http://127.0.0.1:{self.port}/"

    @property
    def environ(self) -> Mapping[str, str]:
        """The environment of this master's nodes."""
        return {"ROSSEC_HOME": str(self.site.root), "ROS_IP": "127.0.0.1", "ROS_MASTER_URI": self.uri}

    async def start(self, *options: str, **variables: str) -> None:
        """Run `rossec master`, and wait until it answers."""
        base = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
        with self.log.open("ab") as log:
            self.process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-I",
                "-m",
                "rossec",
                "master",
                *options,
                env={**base, **self.environ, **variables},
                stdin=asyncio.subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )
        process = self.process

        def up() -> bool:
            assert process.returncode is None, self.log.read_text()
            with socket.socket() as probe:
                return probe.connect_ex(("127.0.0.1", self.port)) == 0

        await until(up, within=40)

    async def kill(self) -> None:
        """As `kill -9`."""
        assert self.process is not None
        self.process.kill()
        await self.process.wait()

    async def terminate(self) -> int:
        """Send SIGTERM, as a service manager does; the exit code."""
        assert self.process is not None
        self.process.terminate()
        async with asyncio.timeout(30):
            return await self.process.wait()


@contextlib.asynccontextmanager
async def master_process(root: Path) -> AsyncIterator[MasterProcess]:
    """A site below `root`, its master not yet started; killed at the end."""
    master = MasterProcess(Site(root))
    try:
        yield master
    finally:
        if master.process is not None and master.process.returncode is None:
            await master.kill()
