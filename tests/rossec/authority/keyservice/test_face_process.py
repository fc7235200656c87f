"""The face as a process: without the key, started again, refused at the socket."""

import asyncio
import contextlib
import os
import signal
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from ca.encoding import Value
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice import process as module
from rossec.authority.keyservice.process import FrontEndOptions, FrontEndProcess
from rossec.clock import now
from rossec.errors import ConfigurationError, KeyServiceRefused, PeerUserRefused
from rossec.host.local_sockets import UnixPeer
from tests.support.commands import PASSPHRASE
from tests.support.ports import free_port
from tests.support.witness import until


@pytest.fixture
def home(tmp_path: Path) -> AuthorityHome:
    return AuthorityHome.create(tmp_path / "home", "home", PASSPHRASE, now())


def face_at(home: AuthorityHome, where: str) -> FrontEndProcess:
    return FrontEndProcess(home, FrontEndOptions(where, "http://127.0.0.1:1/"), os.environ)


async def no_join(_: Value) -> Value:
    return None


@contextlib.asynccontextmanager
async def running(face: FrontEndProcess) -> AsyncIterator[None]:
    face.spawn()
    task = asyncio.ensure_future(face.run(no_join))
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def children() -> set[int]:
    """The processes that this one started."""
    return {int(pid) for pid in Path("/proc/thread-self/children").read_text().split()}


def command_of(process: int) -> bytes:
    return Path(f"/proc/{process}/cmdline").read_bytes()


async def test_it_listens_and_is_refused_at_the_socket(home: AuthorityHome) -> None:
    port, before = free_port(), children()
    face = face_at(home, f"127.0.0.1:{port}")
    async with running(face):
        assert await face.started() == port == face.port
        (process,) = children() - before
        assert b"rossec.authority.keyservice.front_end" in command_of(process)
        with pytest.raises(PeerUserRefused, match="network process"):
            face.admit(UnixPeer(process, os.getuid()))
        face.admit(UnixPeer(os.getpid(), os.getuid()))
        with pytest.raises(KeyServiceRefused):
            await face.call("getPid", [], 2)
    assert process not in children(), "it ended with the service"
    with pytest.raises(KeyServiceRefused, match="does not run"):
        await face.call("getPid", [], 2)


async def test_one_that_dies_is_started_again(home: AuthorityHome, caplog: pytest.LogCaptureFixture) -> None:
    before = children()
    face = face_at(home, f"127.0.0.1:{free_port()}")
    async with running(face):
        await face.started()
        (first,) = children() - before
        os.kill(first, signal.SIGKILL)
        await until(lambda: bool(children() - before - {first}), within=30)
        assert "it is started again in 1 s" in caplog.text


async def test_one_that_cannot_listen_is_an_error(home: AuthorityHome) -> None:
    face = face_at(home, "203.0.113.7:9")  # no address of this host
    async with running(face):
        with pytest.raises(ConfigurationError, match="cannot listen") as caught:
            await face.started()
        assert "--join-address" in caught.value.hint


async def test_one_that_does_not_start_is_an_error(
    home: AuthorityHome, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "START", 0.01)
    face = face_at(home, f"127.0.0.1:{free_port()}")
    async with running(face):
        with pytest.raises(ConfigurationError, match="does not start"):
            await face.started()


def test_one_that_was_never_connected_is_ended(home: AuthorityHome) -> None:
    before = children()
    face = face_at(home, f"127.0.0.1:{free_port()}")
    face.spawn()
    assert children() - before
    face.close()
    assert not children() - before


async def test_one_that_lingers_after_its_connection_is_refused_until_it_is_dead(home: AuthorityHome) -> None:
    answer, before = home.path / "answer", children()
    options = FrontEndOptions(str(home.path), str(answer))
    face = FrontEndProcess(home, options, os.environ, module="tests.support.takenface")
    async with running(face):
        await until(answer.exists, within=20)
        (process,) = children() - before
        with pytest.raises(PeerUserRefused):
            face.admit(UnixPeer(process, os.getuid()))
        await until(lambda: process not in children(), within=20)
        face.admit(UnixPeer(process, os.getuid()))  # the number may be another's now


async def test_what_it_says_of_an_error_is_one_printable_line(
    home: AuthorityHome, caplog: pytest.LogCaptureFixture
) -> None:
    face = FrontEndProcess(home, FrontEndOptions("x", "y"), os.environ, module="tests.support.shoutingface")
    async with running(face):
        with pytest.raises(ConfigurationError) as caught:
            await face.started()
    assert "\x1b" not in caplog.text + str(caught.value) + caught.value.hint
    assert "\n" not in str(caught.value) + caught.value.hint
