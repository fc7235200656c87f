"""The console's service with real processes: service, network face, master, and a played phone."""

import asyncio
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from ca.errors import HintedError
from rossec.authority.console.client import ConsoleClient
from rossec.authority.console.messages import SOCKET, ApprovalOutcome, PasskeyAssertion, PasskeyRegistration
from tests.support.passkeys import Passkey
from tests.support.ports import free_port
from tests.support.serviceprocess import ServiceProcess

DAY = 86_400
ROUND = 60  # seconds: nothing here waits for the next one


class Home:
    """A service, its master, and a console with one phone."""

    def __init__(self, root: Path) -> None:
        self.service, self.port = ServiceProcess(root), free_port()
        self.service.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{self.port}/"
        self.phone = Passkey()
        self.client = ConsoleClient(self.service.directory / SOCKET)
        self.master: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        self.master = subprocess.Popen(
            [sys.executable, "-I", "-m", "rossec", "master", "--port", str(self.port)],
            env=self.service.environ,
            stdin=subprocess.DEVNULL,
        )
        self.service.start("--join-address", f"127.0.0.1:{free_port()}")

    async def add_phone(self) -> None:
        """As a person does with a code from the terminal."""
        with_key = self.service.client()
        code = with_key.phone_code()
        with_key.close()
        challenge = await self.client.new_passkey(self.phone.origin, self.phone.rp_id)
        made = self.phone.register(challenge.challenge)
        await self.client.add_passkey(PasskeyRegistration(challenge.id, code, "Ann's phone", *made))

    async def approve(self, kind: str, *arguments: int | str | bytes) -> ApprovalOutcome:
        prepared = await self.client.prepare(kind, [*arguments])
        signed = self.phone.sign(prepared.challenge)
        return await self.client.approve(prepared.id, PasskeyAssertion(*signed))

    async def enroll(self, name: str) -> ApprovalOutcome:
        await asyncio.to_thread(self.service.run, "node", "request", name)
        csr = (self.service.root / "nodes" / name[1:] / "node.csr").read_bytes()
        return await self.approve("enroll", csr, "a test", False, 30 * DAY, False)

    async def close(self) -> None:
        await self.client.close()
        self.service.close()
        if self.master is not None:
            self.master.kill()
            self.master.wait()


@pytest.fixture
async def home(tmp_path: Path) -> AsyncIterator[Home]:
    home = await asyncio.to_thread(Home, tmp_path / "home")
    try:
        await asyncio.to_thread(home.start)
        await home.add_phone()
        yield home
    finally:
        await home.close()


async def until(holds: Callable[[], Coroutine[Any, Any, bool]], within: float = 30) -> None:
    end = time.monotonic() + within
    while not await holds():
        assert time.monotonic() < end, "it does not come true"
        await asyncio.sleep(0.2)


@pytest.mark.timeout(240)
async def test_what_was_done_while_locked_reaches_the_master_when_it_is_unlocked(home: Home) -> None:
    service, client = home.service, home.client
    assert (await home.enroll("/robot")).state == "done"

    async def has_answered() -> bool:
        try:
            return not await client.graph() and not await client.denials()
        except HintedError:  # the master is starting
            return False

    await until(has_answered)
    await asyncio.to_thread(service.run, "ca", "lock")
    assert await client.revoke_node("/robot", "lost") == (0, 0)
    waits = await home.enroll("/late")
    assert waits.state == "waiting"
    trust_status = await client.trust_status(0, 0)
    assert not trust_status.is_signed
    unlocked = time.monotonic()
    await asyncio.to_thread(service.run, "ca", "unlock", "--passphrase-file", str(service.secret))

    async def has_come() -> bool:
        found = await client.trust_status(0, 0)
        return found.is_signed and found.is_at_master

    await until(has_come)
    outcome = await client.outcome(waits.id)
    assert (outcome.state, outcome.data[:10]) == ("done", b"-----BEGIN")
    assert time.monotonic() - unlocked < ROUND
    audit = service.audit()
    assert "revoke-node /robot, asked by the console of user" in audit
    assert f"for approval {waits.id.hex()} (enroll) by the phone" in audit
    await asyncio.to_thread(service.run, "console", "approvals", "--verify")


@pytest.mark.timeout(240)
async def test_a_kill_while_something_waits_loses_nothing(home: Home) -> None:
    await asyncio.to_thread(home.service.run, "ca", "lock")
    waits = await home.enroll("/late")
    home.service.kill()
    await asyncio.to_thread(home.service.start, "--no-network")

    async def is_done() -> bool:
        return (await home.client.outcome(waits.id)).state == "done"

    await until(is_done)
