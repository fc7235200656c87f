"""`rossec ca serve` and its console: a phone from its first code to what it approves."""

import asyncio
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from ca.approvals.statement import Statement
from ca.errors import HintedError
from rossec.authority.console.client import ConsoleClient
from rossec.authority.console.messages import SOCKET, PasskeyAssertion, PasskeyRegistration
from rossec.errors import PhoneCodeRefused
from tests.support.passkeys import ORIGIN, RP_ID, Passkey
from tests.support.ports import free_port
from tests.support.serviceprocess import ServiceProcess

CODE = """
import sys
from pathlib import Path
from rossec.authority.keyservice.client import KeyServiceClient
print(KeyServiceClient.find(Path(sys.argv[1])).phone_code())
"""


def start(service: ServiceProcess) -> None:
    assert service.start("--unlock-for", "0", "--join-address", f"127.0.0.1:{free_port()}")


@pytest.fixture
def service(tmp_path: Path) -> Iterator[ServiceProcess]:
    service = ServiceProcess(tmp_path / "home")
    start(service)
    yield service
    service.close()


def code_of(service: ServiceProcess) -> str:
    """A code, asked for by a process of its own: this one is at the console's socket."""
    program = [sys.executable, "-I", "-c", CODE, str(service.directory)]
    done = subprocess.run(program, capture_output=True, text=True, check=True, timeout=30)
    return done.stdout.strip()


async def add(client: ConsoleClient, phone: Passkey, code: str, name: str) -> None:
    asked = await client.new_passkey(ORIGIN, RP_ID)
    answer = phone.register(asked.challenge)
    await client.add_passkey(PasskeyRegistration(asked.id, code, name, *answer))


async def test_a_phone_comes_in_and_approves(service: ServiceProcess) -> None:
    client, phone = ConsoleClient(service.directory / SOCKET), Passkey()
    before = await client.status()
    assert (before.domain, before.locked, before.phones) == ("home", False, 0)
    code = await asyncio.to_thread(code_of, service)
    await add(client, phone, code, "Ann's phone")
    with pytest.raises(PhoneCodeRefused):
        await client.redeem(code)
    asked = await client.login_challenge(ORIGIN)
    assert await client.login(asked.id, PasskeyAssertion(*phone.sign(asked.challenge))) == "Ann's phone"
    prepared = await client.prepare("invitation", ["/lamp/*", 2, 3600, False])
    assert Statement.from_bytes(prepared.statement).challenge == prepared.challenge
    touch = PasskeyAssertion(*phone.sign(prepared.challenge))
    outcome = await client.approve(prepared.id, touch)
    assert outcome.state == "done"
    with pytest.raises(HintedError):
        await client.approve(prepared.id, touch)
    assert [each.pattern for each in await client.invitations()] == ["/lamp/*"]
    (approval,) = await client.approvals(5)
    assert (approval.phone, approval.sentence) == ("Ann's phone", "join code for 2 of /lamp/*")
    after = await client.status()
    assert (after.number != before.number, after.phones) == (True, 1)
    await client.close()
    audit = service.audit()
    for line in ("makes a code for a phone, for user", "adds the phone", "logged in"):
        assert line in audit
    assert code not in audit
    service.run("ca", "log", "verify")


async def test_a_service_that_was_killed_knows_phones_and_no_codes(service: ServiceProcess) -> None:
    client, phone = ConsoleClient(service.directory / SOCKET), Passkey()
    await add(client, phone, await asyncio.to_thread(code_of, service), "Ann's phone")
    code = await asyncio.to_thread(code_of, service)
    asked = await client.login_challenge(ORIGIN)
    prepared = await client.prepare("invitation", ["/lamp/*", 2, 3600, False])
    await asyncio.to_thread(service.kill)
    await asyncio.to_thread(start, service)
    for attempt in (
        client.redeem(code),
        client.login(asked.id, PasskeyAssertion(*phone.sign(asked.challenge))),
        client.approve(prepared.id, PasskeyAssertion(*phone.sign(prepared.challenge))),
    ):
        with pytest.raises(HintedError):
            await attempt
    assert [each.name for each in await client.phones()] == ["Ann's phone"]
    asked = await client.login_challenge(ORIGIN)
    assert await client.login(asked.id, PasskeyAssertion(*phone.sign(asked.challenge))) == "Ann's phone"
    assert await client.invitations() == ()
    await client.close()
    await asyncio.to_thread(service.run, "ca", "log", "verify")
