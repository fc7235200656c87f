"""What a command gets from the service that runs, and what it does without one."""

import os
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from ca.errors import PassphraseRefused
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice import client as module
from rossec.authority.keyservice import messages
from rossec.authority.keyservice.client import KeyServiceClient, RemoteSigner, running_signer
from rossec.authority.keyservice.messages import SOCKET, ServiceRequest
from rossec.errors import (
    AuthorityLocked,
    KeyMessageRefused,
    KeyServiceFailed,
    KeyServiceRefused,
    PeerUserRefused,
    SigningRefused,
)
from tests.support.commands import PASSPHRASE
from tests.support.keyservice import RunningService, running_service

NOW = 1_800_000_000


@pytest.fixture
def home(tmp_path: Path) -> AuthorityHome:
    return AuthorityHome.create(tmp_path, "home", PASSPHRASE, NOW)


@pytest.fixture
def service(home: AuthorityHome) -> Iterator[RunningService]:
    with running_service(home) as service:
        yield service


def found(home: AuthorityHome) -> KeyServiceClient:
    client = KeyServiceClient.find(home.path)
    assert client is not None
    return client


def test_without_a_service_there_is_no_signer(home: AuthorityHome) -> None:
    assert running_signer(home) is None
    with socket.socket(socket.AF_UNIX) as stale:
        stale.bind(str(home.path / SOCKET))
    assert running_signer(home) is None, "what a killed service left behind"
    assert KeyServiceClient.find(home.path / ("x" * 108)) is None


def test_a_locked_service_is_a_refusal_with_a_hint(home: AuthorityHome, service: RunningService) -> None:
    with pytest.raises(AuthorityLocked, match="service is locked") as caught:
        running_signer(home)
    assert "rossec ca unlock" in caught.value.hint
    assert service.audit == []


def test_the_authority_works_with_the_key_of_the_service(
    home: AuthorityHome, service: RunningService
) -> None:
    client = found(home)
    assert client.status()["domain"] == "home"
    assert client.unlock(PASSPHRASE, 60)["remaining"] == 60
    signer = running_signer(home)
    assert signer is not None
    authority = home.open(signer)
    listed = authority.revoke(b"k" * 32, "lost", NOW)
    assert b"k" * 32 in listed.entries
    authority.store.log.audit(home.anchor().public_key)
    assert [line.split(",")[0] for line in service.audit[1:]] == [
        "signs a revocation list",
        "signs a head of the log",
    ]
    assert f"process {os.getpid()}" in service.audit[1]
    assert client.lock()["locked"] is True
    with pytest.raises(AuthorityLocked):
        authority.revoke(b"l" * 32, "lost", NOW)
    assert authority.store.revoked_entries() == {b"k" * 32}, "and nothing is recorded"
    signer.close()
    client.close()


def test_refusals_come_back_as_what_they_are(home: AuthorityHome, service: RunningService) -> None:
    client = found(home)
    with pytest.raises(PassphraseRefused):
        client.unlock("wrong", 60)
    with pytest.raises(KeyServiceRefused, match="may be tried in"):
        client.unlock(PASSPHRASE, 60)
    with pytest.raises(SigningRefused):
        client.ask(ServiceRequest("sign", (b"a challenge",)))
    assert service.audit[0].startswith("failed to unlock for user")
    client.close()


def test_a_restarted_service_is_asked_again(home: AuthorityHome) -> None:
    with running_service(home):
        client = found(home)
        assert client.status()["locked"]
    with running_service(home):
        assert client.status()["locked"]
    with pytest.raises(KeyServiceFailed, match="does not answer"):
        client.status()
    client.close()


def test_another_user_at_the_socket_is_refused(
    home: AuthorityHome, service: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> int:
        raise PeerUserRefused("user 7 may not use this connection")

    monkeypatch.setattr(module, "require_user", refuse)
    with pytest.raises(KeyServiceFailed, match="another user listens"):
        KeyServiceClient.find(home.path)


def test_a_socket_that_cannot_be_opened_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(KeyServiceFailed):
        KeyServiceClient.find(tmp_path / "file")


class Impostor:
    """Answers each request with the next of `answers`, whatever it was."""

    def __init__(self, path: Path, *answers: bytes) -> None:
        self.server = socket.socket(socket.AF_UNIX)
        self.server.bind(str(path))
        self.server.listen()
        self.thread = threading.Thread(target=self._run, args=(answers,))
        self.thread.start()

    def _run(self, answers: tuple[bytes, ...]) -> None:
        sock, _ = self.server.accept()
        with sock:
            for answer in answers:
                sock.recv(65536)
                sock.sendall(answer)
        self.server.close()


def test_a_signature_of_another_key_is_not_used(home: AuthorityHome) -> None:
    other = KeySigner(generate())
    answers = [messages.write_answer(other.sign(b"m")), messages.write_answer(b"")]
    impostor = Impostor(home.path / SOCKET, *answers, messages.write_answer("text"))
    signer = RemoteSigner(found(home), home.own_key())
    for _ in range(3):
        with pytest.raises(KeyServiceFailed, match="another key"):
            signer.sign(b"m")
    assert signer.public_key == home.own_key()
    signer.close()
    impostor.thread.join()


@pytest.mark.parametrize(
    "answer", [messages.write_answer(7), messages.write_answer({"locked": 1}), b"\0\0\0\1\xff"]
)
def test_an_answer_that_makes_no_sense_is_refused(home: AuthorityHome, answer: bytes) -> None:
    impostor = Impostor(home.path / SOCKET, answer)
    client = found(home)
    with pytest.raises((KeyServiceFailed, KeyMessageRefused)):
        client.status()
    client.close()
    impostor.thread.join()


def test_a_code_that_is_no_text_is_refused(home: AuthorityHome) -> None:
    answers = [messages.write_answer("code"), messages.write_answer(7)]
    impostor = Impostor(home.path / SOCKET, *answers)
    client = found(home)
    assert client.phone_code() == "code"
    with pytest.raises(KeyServiceFailed, match="gives no code"):
        client.phone_code()
    client.close()
    impostor.thread.join()


def test_a_service_that_hangs_is_given_up(home: AuthorityHome, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "TIMEOUT", 0.05)
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(home.path / SOCKET))
        server.listen()
        client = found(home)
        with pytest.raises(KeyServiceFailed, match="does not answer"):
            client.status()
