"""`rossec router` as a separate process, and a router with accounts in this one."""

import asyncio
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from rossec.overlay.documents import OPEN_ACCOUNT, Routers
from rossec.overlay.homes import RouterHome
from rossec.overlay.router_settings import Accounts, zenoh_settings
from rossec.overlay.zenoh_carrier import open_session
from tests.support.ports import free_port

HOST = "127.0.0.1"
PASSWORD = "p" * 40


def home_with(path: Path, *accounts: str, protocol: str = "tls", join: tuple[str, ...] = ()) -> RouterHome:
    """A router's directory, told a free port, with these accounts; their passwords are known."""
    home = RouterHome(path)
    home.prepare()
    home.tell(listen=(f"{protocol}/{HOST}:{free_port()}",), join=join)
    for account in accounts:
        home.change_accounts(partial(_with, account))
    return home


def _with(account: str, accounts: Accounts) -> Accounts:
    return accounts.add(account, PASSWORD + account)


@contextmanager
def running(home: RouterHome) -> Iterator[None]:
    """The router of `home` in this process, with its accounts."""
    settings, accounts = home.settings(), home.accounts()
    home.write_for_zenoh(settings, accounts)
    session = open_session(zenoh_settings(settings, accounts, home.files))
    try:
        yield
    finally:
        session.close()  # type: ignore[no-untyped-call]


class RouterProcess:
    """Starts, freezes, kills and restarts one router.

    Args:
        home: as made by `home_with`; with accounts, or the router is open.
    """

    def __init__(self, home: RouterHome) -> None:
        self.home = home
        self.log = home.path / "router.log"
        self.process: asyncio.subprocess.Process | None = None

    @property
    def locator(self) -> str:
        return self.home.settings().listen[0]

    def routers(self, account: str = OPEN_ACCOUNT) -> Routers:
        """What a relay needs."""
        return self.home.account_file(account)

    async def start(self, *options: str, **variables: str) -> None:
        """Run `rossec -v router` with these variables, and wait until it listens."""
        is_open = [] if self.home.accounts().names else ["--open"]
        base = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
        with self.log.open("ab") as log:
            self.process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-I",
                "-m",
                "rossec",
                "-v",
                "router",
                "--home",
                str(self.home.path),
                "--json",
                *is_open,
                *options,
                env=base | variables,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=log,
            )
        assert self.process.stdout is not None
        async with asyncio.timeout(40):
            ready = await self.process.stdout.readline()
        assert b"ready" in ready, self.log.read_text()

    def freeze(self) -> None:
        """As `kill -STOP`: it is there, and answers nothing."""
        self._signal(signal.SIGSTOP)

    def thaw(self) -> None:
        self._signal(signal.SIGCONT)

    async def kill(self) -> None:
        """As `kill -9`."""
        self._signal(signal.SIGKILL)
        await self._wait()

    async def stop(self) -> int:
        """End it in order; its exit code."""
        if self.process is None:
            return 0
        self._signal(signal.SIGCONT)
        self._signal(signal.SIGTERM)
        return await self._wait()

    def _signal(self, number: int) -> None:
        assert self.process is not None
        if self.process.returncode is None:
            self.process.send_signal(number)

    async def _wait(self) -> int:
        assert self.process is not None
        async with asyncio.timeout(20):
            code = await self.process.wait()
        self.process = None
        return code
