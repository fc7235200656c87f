"""Attacks at the console's socket: pages that were taken over, guessed codes, noise."""

import asyncio
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from ca.errors import ApprovalRefused, HintedError
from rossec.authority.console.access import MAX_FAILURES, ConsoleAccess
from rossec.authority.console.client import ConsoleClient
from rossec.authority.console.messages import (
    MAX_REQUEST,
    OPERATIONS,
    SOCKET,
    LoginChallenge,
    PasskeyAssertion,
    PasskeyRegistration,
    from_value,
)
from rossec.authority.keyservice import messages
from rossec.errors import KeyMessageRefused, KeyServiceFailed, PhoneCodeRefused
from tests.support import refusal_texts
from tests.support.commands import PASSPHRASE
from tests.support.consolework import ConsoleWork, ask
from tests.support.passkeys import ORIGIN, RP_ID, Passkey
from tests.support.serviceprocess import ServiceProcess

NOBODY = 65534
LISTEN = """
import socket, sys
server = socket.socket(socket.AF_UNIX)
server.bind(sys.argv[1])
server.listen()
print("ready", flush=True)
sys.stdin.read()
"""
KEY_AT_ALL = ("sign", "unlock", "lock", "phone-code")
USE = """
import asyncio, os, resource, sys
from pathlib import Path
from rossec.authority.console.client import ConsoleClient
from rossec.authority.keyservice.client import KeyServiceClient
directory, way, passphrase = Path(sys.argv[1]), sys.argv[2], sys.argv[3]
if way in {"showed itself", "began anew"}:
    asyncio.run(ConsoleClient(directory / "console.sock").status())
if way == "began anew":  # another program in the same process
    program = [sys.executable, "-I", "-c", sys.argv[4]]
    os.execv(sys.executable, [*program, str(directory), "", passphrase, ""])
if way == "confined":
    resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))
for act in ("phone_code", "status", "lock", "unlock"):
    client = KeyServiceClient.find(directory)
    try:
        getattr(client, act)(*(passphrase, 60) * (act == "unlock"))
        print("done:", act)
    except Exception as error:
        print(type(error).__name__)
"""


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    service = ServiceProcess(tmp_path_factory.mktemp("service") / "home")
    service.start("--unlock-for", "0", "--no-network")
    yield service
    service.close()


def use_key(service: ServiceProcess, way: str) -> set[str]:
    """What a program of the user gets at the service's socket, if it comes in this way."""
    done = subprocess.run(
        [sys.executable, "-I", "-c", USE, str(service.directory), way, PASSPHRASE, USE],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    return set(done.stdout.splitlines())


@pytest.mark.attack("console-takeover")
@pytest.mark.parametrize("way", ["showed itself", "began anew", "confined"])
def test_pages_that_were_taken_over_cannot_use_the_key(service: ServiceProcess, way: str) -> None:
    assert use_key(service, way) == {"KeyServiceFailed"}
    assert "done: status" in use_key(service, "as a command"), "and a command can"


@pytest.mark.attack("console-takeover")
async def test_the_socket_of_the_console_signs_and_unlocks_nothing(service: ServiceProcess) -> None:
    path = service.directory / SOCKET
    assert not OPERATIONS.keys() & set(KEY_AT_ALL)
    for request in (
        [1, "sign", b"m"],
        [1, "unlock", 60, PASSPHRASE],
        [1, "lock"],
        [1, "phone-code"],
        [1, "prepare", "everything", []],
        [1, "status", 1],
    ):
        reader, writer = await asyncio.open_unix_connection(path)
        writer.write(messages.frame(request))  # type: ignore[arg-type]
        head = await reader.readexactly(messages.HEAD)
        with pytest.raises(KeyMessageRefused):
            messages.read_answer(await reader.readexactly(messages.frame_size(head)))
        assert await reader.read() == b""
        writer.close()


@pytest.mark.attack("console-takeover")
async def test_what_a_session_knows_adds_no_phone(service: ServiceProcess) -> None:
    """Whoever stole a cookie, or the process of the pages, can have a link, and no code."""
    client, phone = ConsoleClient(service.directory / SOCKET), Passkey()
    link = await client.phone_link()
    for code in (link, "", "A" * 22):
        asked = await client.new_passkey(ORIGIN, RP_ID)
        answer = phone.register(asked.challenge)
        with pytest.raises(PhoneCodeRefused):
            await client.add_passkey(PasskeyRegistration(asked.id, code, "Eve's", *answer))
    asked = await client.new_passkey(ORIGIN, RP_ID)
    proposed = PasskeyRegistration(asked.id, link, "Eve's", *phone.register(asked.challenge))
    proposal = await client.propose_passkey(proposed)
    assert await client.phones() == (), "it waits for a phone that is there"
    with pytest.raises(HintedError):
        await client.approve(proposal.id, PasskeyAssertion(*phone.sign(asked.challenge)))
    assert await client.phones() == ()
    await client.close()


@pytest.mark.attack("console-socket")
@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_another_user_cannot_come_to_the_console(service: ServiceProcess) -> None:
    program = "import socket, sys; socket.socket(socket.AF_UNIX).connect(sys.argv[1])"
    done = subprocess.run(
        [sys.executable, "-c", program, str(service.directory / SOCKET)],
        user=NOBODY,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "PermissionError" in done.stderr


@pytest.mark.attack("console-socket")
async def test_noise_at_the_console_harms_neither_it_nor_commands(service: ServiceProcess) -> None:
    path = service.directory / SOCKET
    silent = [await asyncio.open_unix_connection(path) for _ in range(8)]
    huge = (MAX_REQUEST + 1).to_bytes(4)
    for data in (b"\xff" * 100, b"\0\0\0\0", huge, os.urandom(4000), b"GET / HTTP/1.1\r\n\r\n"):
        reader, writer = await asyncio.open_unix_connection(path)
        writer.write(data)
        head = await reader.readexactly(messages.HEAD)
        with pytest.raises(KeyMessageRefused):
            messages.read_answer(await reader.readexactly(messages.frame_size(head)))
        writer.close()
    client = ConsoleClient(path)
    assert (await client.status()).domain == "home"
    assert "home" in (await asyncio.to_thread(service.run, "ca", "status")).stdout
    await client.close()
    for _, writer in silent:
        writer.close()


@pytest.mark.attack("console-socket")
async def test_a_program_that_takes_all_places_blocks_no_command(service: ServiceProcess) -> None:
    path = service.directory / SOCKET
    others = [await asyncio.open_unix_connection(path) for _ in range(40)]
    assert "home" in (await asyncio.to_thread(service.run, "ca", "status")).stdout
    for _, writer in others:
        writer.close()


@pytest.mark.attack("console-socket")
@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_a_program_in_the_place_of_the_service_is_not_believed() -> None:
    """Another user listens where this one's console looks, in a directory that all can write."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / SOCKET
        path.parent.chmod(0o777)
        with subprocess.Popen(
            [sys.executable, "-I", "-c", LISTEN, str(path)],
            user=NOBODY,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        ) as impostor:
            assert impostor.stdout is not None
            assert impostor.stdout.readline() == b"ready\n"
            with pytest.raises(KeyServiceFailed, match="another user listens"):
                asyncio.run(ConsoleClient(path).status())
            impostor.communicate()


@pytest.mark.attack("console-codes")
def test_a_code_is_used_once_whoever_is_first(tmp_path: Path) -> None:
    site = ConsoleWork(tmp_path)
    access = ConsoleAccess(site.work, site.audit.append, site.elapsed)
    code = access.phone_code("a person")
    ask(access, "redeem", code)
    with pytest.raises(PhoneCodeRefused):
        ask(access, "redeem", code)
    assert sum("was used at the console" in line for line in site.audit) == 1


@pytest.mark.attack("console-codes")
def test_codes_cannot_be_tried_at_will_and_trying_keeps_nobody_out(tmp_path: Path) -> None:
    site = ConsoleWork(tmp_path)
    access = ConsoleAccess(site.work, site.audit.append, site.elapsed)
    code = access.phone_code("a person")
    for number in range(MAX_FAILURES):
        with pytest.raises(PhoneCodeRefused, match="not valid"):
            ask(access, "redeem", f"{number:022}")
    with pytest.raises(PhoneCodeRefused, match="too many"):
        ask(access, "redeem", "A" * 22)
    ask(access, "redeem", code)
    with pytest.raises(PhoneCodeRefused, match="too many"):
        ask(access, "redeem", code)


@pytest.mark.attack("console-codes")
def test_a_clock_that_stands_makes_no_code_last(tmp_path: Path) -> None:
    """The host's clock is stopped or set back; what ends codes and challenges is another one."""
    site = ConsoleWork(tmp_path)
    access, phone = ConsoleAccess(site.work, site.audit.append, site.elapsed), Passkey()
    code = access.phone_code("a person")
    asked = from_value(LoginChallenge, ask(access, "new-passkey", ORIGIN, RP_ID))
    site.seconds += 130
    site.now -= 86_400
    with pytest.raises(PhoneCodeRefused):
        ask(access, "redeem", code)
    site.seconds += 200
    fresh, answer = access.phone_code("a person"), phone.register(asked.challenge)
    with pytest.raises(ApprovalRefused, match=refusal_texts.OTHER_CHALLENGE):
        ask(access, "add-passkey", asked.id, fresh, "late", *answer)
