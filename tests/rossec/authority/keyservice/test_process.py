"""The process put together: its key, its audit on disk, its time."""

import asyncio
import json
import os
from pathlib import Path

import pytest

from ca.errors import CAError, PassphraseRefused
from ca.keys import private_keys
from rossec.authority.home import AUDIT_FILE, AuthorityHome
from rossec.authority.keyservice import process as module
from rossec.authority.keyservice.client import KeyServiceClient
from rossec.authority.keyservice.operations import KeyOperations
from rossec.authority.keyservice.process import (
    AuditedCaller,
    KeyServiceProcess,
    admit_all,
    audit_to,
    operations_of,
)
from rossec.errors import KeyServiceRefused
from rossec.host.audit import audit_written
from tests.support import refusal_texts
from tests.support.commands import PASSPHRASE

NOW = 1_800_000_000


@pytest.fixture
def home(tmp_path: Path) -> AuthorityHome:
    return AuthorityHome.create(tmp_path, "home", PASSPHRASE, NOW)


def test_a_key_of_another_certificate_is_refused(home: AuthorityHome) -> None:
    operations = operations_of(home, lambda _: None)
    with pytest.raises(PassphraseRefused):
        operations.unlock("wrong", 60, "a test")
    (home.path / "ca.key").unlink()
    private_keys.write_private(home.path / "ca.key", private_keys.generate(), PASSPHRASE)
    operations = operations_of(home, lambda _: None)
    with pytest.raises(CAError, match=refusal_texts.ISSUE_REFUSED):
        operations.unlock(PASSPHRASE, 60, "a test")
    assert operations.held.remaining() is None


def test_a_line_that_is_not_written_is_a_refusal(
    home: AuthorityHome, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = home.path / AUDIT_FILE
    with audit_written(path, home.node().signer()) as file:
        write = audit_to(file)
        write("first")
        real = os.write
        monkeypatch.setattr(os, "write", lambda *_: 0)
        with pytest.raises(KeyServiceRefused, match="audit cannot be written"):
            write("second")
        monkeypatch.setattr(os, "write", real)
        write("third")
    texts = [json.loads(line)["text"] for line in path.read_text().splitlines()]
    assert texts == ["the audit begins", "first", "third"]


async def test_codes_for_a_phone_are_made_where_there_is_a_console(home: AuthorityHome) -> None:
    callers: list[AuditedCaller] = []

    def make(caller: AuditedCaller) -> str:
        callers.append(caller)
        return "a code"

    for phone_code in (make, None):
        process = KeyServiceProcess(home, operations_of(home, lambda _: None), admit_all, phone_code)
        await process.start()
        client = await asyncio.to_thread(KeyServiceClient.find, home.path)
        assert client is not None
        if phone_code is None:
            with pytest.raises(KeyServiceRefused, match="has no console"):
                await asyncio.to_thread(client.phone_code)
        else:
            assert await asyncio.to_thread(client.phone_code) == "a code"
        client.close()
        await process.close()
    assert [caller.process for caller in callers] == [os.getpid()]


class Clocked:
    """A service whose clock is set by the test."""

    def __init__(self, home: AuthorityHome) -> None:
        self.lines: list[str] = []
        self.is_full = False
        self.operations: KeyOperations = operations_of(home, self.audit)
        self.process = KeyServiceProcess(home, self.operations, admit_all)

    def audit(self, text: str) -> None:
        if self.is_full:
            raise KeyServiceRefused("the audit cannot be written")
        self.lines.append(text)


@pytest.mark.parametrize("is_full", [False, True])
async def test_the_key_is_dropped_when_its_time_is_over(
    home: AuthorityHome, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, is_full: bool
) -> None:
    monkeypatch.setattr(module, "TICK", 0.01)
    clocked = Clocked(home)
    clocked.operations.unlock(PASSPHRASE, 1, "a test")
    clocked.is_full = is_full
    with pytest.raises(TimeoutError):
        await asyncio.wait_for(clocked.process.watch_time(), 1.2)
    assert not clocked.operations.held.lock(), "it is dropped, not only refused"
    assert clocked.lines[1:] == ([] if is_full else ["locked: its time is over"])
    assert ("cannot be written" in caplog.text) is is_full


async def test_commands_are_answered_until_it_is_closed(home: AuthorityHome) -> None:
    clocked = Clocked(home)
    await clocked.process.start()
    client = await asyncio.to_thread(KeyServiceClient.find, home.path)
    assert client is not None
    status = await asyncio.to_thread(client.unlock, PASSPHRASE, 0)
    assert (status["locked"], status["remaining"], status["domain"]) == (False, 0, "home")
    assert isinstance(status["fingerprint"], str)
    await clocked.process.close()
    assert clocked.operations.held.remaining() is None
    assert await asyncio.to_thread(KeyServiceClient.find, home.path) is None
    client.close()
