"""Attacks on the authority's service: on its socket, by its face, by programs of other users."""

import asyncio
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from ca.certificates import PROFILE as RENEWAL
from ca.encoding import Value
from ca.errors import PassphraseRefused
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice import messages
from rossec.authority.keyservice import messages as inner_messages
from rossec.authority.keyservice.client import KeyServiceClient
from rossec.authority.keyservice.front_end import InnerChannel
from rossec.authority.keyservice.messages import InnerRequest, ServiceRequest
from rossec.authority.keyservice.process import FrontEndOptions, FrontEndProcess
from rossec.errors import (
    AuthorityLocked,
    KeyMessageRefused,
    KeyServiceFailed,
    KeyServiceRefused,
    PeerUserRefused,
    SigningRefused,
)
from rossec.host.local_sockets import UnixPeer
from tests.support.commands import PASSPHRASE
from tests.support.keyservice import RunningService, running_service
from tests.support.pki import new_signer
from tests.support.witness import until

NOW = 1_800_000_000
NOBODY = 65534
CONNECT = "import socket, sys; socket.socket(socket.AF_UNIX).connect(sys.argv[1])"


@pytest.fixture
def home(tmp_path: Path) -> AuthorityHome:
    return AuthorityHome.create(tmp_path / "home", "home", PASSPHRASE, NOW)


@pytest.fixture
def service(home: AuthorityHome) -> Iterator[RunningService]:
    with running_service(home) as service:
        service.operations.unlock(PASSPHRASE, 0, "a test")
        yield service


def found(home: AuthorityHome) -> KeyServiceClient:
    client = KeyServiceClient.find(home.path)
    assert client is not None
    return client


@pytest.mark.attack("agent-oracle")
def test_bytes_that_are_no_statement_are_not_signed(home: AuthorityHome, service: RunningService) -> None:
    """A program of the user has the agent sign a challenge of another protocol."""
    seen: list[bytes] = []

    class Recorder:
        public_key = new_signer().public_key

        def sign(self, message: bytes) -> bytes:
            seen.append(message)
            return bytes(64)

    RENEWAL.sign(Recorder(), {1: "of a node"})
    client = found(home)
    for message in (b"challenge", b"", bytes(64 * 1024), *seen):
        with pytest.raises(SigningRefused):
            client.ask(ServiceRequest("sign", (message,)))
    assert sum("refused to sign" in line for line in service.audit) == 4
    client.close()


@pytest.mark.attack("key-socket")
@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_another_user_cannot_connect(home: AuthorityHome, service: RunningService) -> None:
    done = subprocess.run(
        [sys.executable, "-c", CONNECT, str(home.path / messages.SOCKET)],
        user=NOBODY,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "PermissionError" in done.stderr


@pytest.mark.attack("key-socket")
def test_garbage_huge_frames_and_silence_harm_no_command(
    home: AuthorityHome, service: RunningService
) -> None:
    silent = [socket.socket(socket.AF_UNIX) for _ in range(40)]
    for sock in silent:
        sock.connect(str(home.path / messages.SOCKET))
    for data in (b"\xff" * 100, b"\xff\xff\xff\xff", b"\0\0\0\0", os.urandom(5000)):
        with socket.socket(socket.AF_UNIX) as sock:
            sock.settimeout(20)
            sock.connect(str(home.path / messages.SOCKET))
            sock.sendall(data)
            head = sock.recv(messages.HEAD)
            with pytest.raises(KeyMessageRefused):
                messages.read_answer(sock.recv(messages.frame_size(head)))
    client = found(home)
    assert client.status()["locked"] is False
    client.close()
    for sock in silent:
        sock.close()


@pytest.mark.attack("key-guess")
def test_passphrases_cannot_be_tried_at_will(home: AuthorityHome, service: RunningService) -> None:
    client = found(home)
    client.lock()
    with pytest.raises(PassphraseRefused):
        client.unlock("wrong", 60)
    for guess in ("again", PASSPHRASE):
        with pytest.raises(KeyServiceRefused, match="may be tried in"):
            client.unlock(guess, 60)
    assert service.audit[-1].startswith("failed to unlock for user")
    client.close()


@pytest.mark.attack("key-impostor")
def test_a_program_that_plays_the_service_signs_nothing(home: AuthorityHome) -> None:
    """It has the socket's place while no service runs, and another key."""
    from ca.keys.private_keys import generate
    from ca.keys.signing import KeySigner
    from rossec.authority.keyservice.client import RemoteSigner
    from tests.rossec.authority.keyservice.test_client import Impostor

    other = KeySigner(generate())
    impostor = Impostor(home.path / messages.SOCKET, messages.write_answer(other.sign(b"m")))
    with pytest.raises(KeyServiceFailed, match="another key"):
        RemoteSigner(client := found(home), home.own_key()).sign(b"m")
    client.close()
    impostor.thread.join()


@pytest.mark.attack("face-takeover")
async def test_a_face_that_was_taken_over_gets_no_signature() -> None:
    """What it can send is the table of the inner messages: everything else ends it."""
    for operation in ("sign", "unlock", "status", "call"):
        ours, theirs = socket.socketpair()
        service = InnerChannel(ours, {"join": _refuse}, inner_messages.MAX_FROM_FACE)
        running = asyncio.ensure_future(service.run())
        _, writer = await asyncio.open_connection(sock=theirs)
        writer.write(inner_messages.write(InnerRequest(1, operation, (b"m",))))
        with pytest.raises(KeyMessageRefused):
            await running
        writer.close()


async def _refuse(_: bytes) -> None:
    pytest.fail("nothing joins")


@pytest.mark.attack("face-takeover")
def test_the_face_is_not_answered_at_the_socket_of_commands(home: AuthorityHome) -> None:
    def admit(peer: UnixPeer) -> None:
        if peer.process == os.getpid():
            raise PeerUserRefused("the network process may not use the service's socket")

    with running_service(home, admit) as service:
        service.operations.unlock(PASSPHRASE, 0, "a test")
        client = found(home)
        with pytest.raises(KeyServiceFailed):
            client.ask(ServiceRequest("status"))
        client.close()


@pytest.mark.attack("face-takeover")
def test_a_face_that_ended_its_connection_is_still_refused(home: AuthorityHome) -> None:
    """It is given time to end, and uses it to ask as a program of the user."""
    answer = home.path / "answer"
    options = FrontEndOptions(str(home.path), str(answer))
    face = FrontEndProcess(home, options, os.environ, module="tests.support.takenface")

    async def run() -> None:
        face.spawn()
        running = asyncio.ensure_future(face.run(_refuse_join))
        await until(answer.exists, within=20)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)

    with running_service(home, face.admit):
        asyncio.run(run())
    assert "KeyServiceFailed" in answer.read_text()


async def _refuse_join(_: Value) -> Value:
    pytest.fail("nothing joins")


@pytest.mark.attack("sleeping-host")
def test_a_machine_that_slept_wakes_up_locked(home: AuthorityHome) -> None:
    from rossec.authority.keyservice.operations import HeldKey

    seconds = [1000.0]
    held = HeldKey(home.load_key, lambda: seconds[0])
    held.unlock(PASSPHRASE, 900)
    seconds[0] += 8 * 3600
    with pytest.raises(AuthorityLocked):
        held.sign(b"m")
    assert held.drop_if_over()
