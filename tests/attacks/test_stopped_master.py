"""A master that is stopped (SIGSTOP, a suspended machine) while something is revoked.

The command reports what happened; nodes do not wait for the master; when it continues, it stops
confirming the old list.
"""

import asyncio
import contextlib
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest

from rossec.home import NodeHome
from rossec.node import Node, Publisher
from rossec.participant import authorized as staleness
from rossec.ros.names import MASTER
from tests.support.commands import Said, Shell
from tests.support.ports import free_port
from tests.support.witness import until

WORDS, TYPE = "/words", "std_msgs/String"
ROSSEC = [sys.executable, "-I", "-m", "rossec"]


class Place:
    """An authority, a master and two nodes, all made by the command line."""

    def __init__(self, root: Path, shell: Shell) -> None:
        self.root = root
        self._shell = shell
        self.environ = {**shell.environ, "ROS_MASTER_URI": f"http://127.0.0.1:{free_port()}/"}
        shell.environ.update(self.environ)
        shell.unlocked("ca", "init", "home")
        for name in (MASTER, "/robot", "/viewer"):
            shell.enroll(name)
        shell.unlocked("grant", "sign", "/robot", "--publish", WORDS)
        said = shell.unlocked("grant", "sign", "/viewer", "--subscribe", WORDS)
        self.grant = said.out.split()[1]

    async def revoke(self, *words: str) -> Said:
        """Run a command that revokes; it has a loop of its own."""
        return await asyncio.to_thread(self._shell.unlocked, *words)

    async def publish(self) -> Said:
        return await asyncio.to_thread(self._shell, "ca", "publish")


@pytest.fixture
def place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Place:
    return Place(tmp_path / "home", Shell(tmp_path / "home", capsys))


@contextlib.asynccontextmanager
async def master_of(place: Place, home: Path) -> AsyncIterator[Callable[[signal.Signals], None]]:
    """The master of `place`, whose home is `home`; yields how to send it a signal."""
    environ = {**place.environ, "ROSSEC_HOME": str(home)}
    process = await asyncio.create_subprocess_exec(
        *ROSSEC, "master", env=environ, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    assert process.stdout is not None
    try:
        async with asyncio.timeout(60):
            await process.stdout.readline()
        yield process.send_signal
    finally:
        process.kill()  # also one that is stopped
        await process.wait()


@contextlib.asynccontextmanager
async def talking(place: Place) -> AsyncIterator[Publisher]:
    async with (
        Node("/robot", environ=place.environ) as robot,
        Node("/viewer", environ=place.environ) as viewer,
    ):
        words = await robot.publisher(WORDS, TYPE)
        await viewer.subscriber(WORDS, TYPE)
        await words.wait_for_subscribers()
        yield words


@pytest.mark.attack("stopped-master")
@pytest.mark.parametrize("what", ["key", "grant"])
async def test_a_revocation_while_the_master_is_stopped_takes_effect(place: Place, what: str) -> None:
    """The authority is on the master's host: the master finds the list in its directory."""
    words = ("ca", "revoke", "/viewer") if what == "key" else ("grant", "revoke", place.grant)
    async with master_of(place, place.root) as send, talking(place) as talker:
        send(signal.SIGSTOP)
        said = await place.revoke(*words)
        assert said.code == 3
        assert said.out.startswith("revoked ")
        assert "did not take the list: the peer did not finish the handshake in time" in said.err
        assert "deliver it with: rossec ca publish" in said.err
        assert talker.links, "the revocation is not known yet"
        send(signal.SIGCONT)
        await until(lambda: not talker.links, within=60)
        assert "takes effect only when the master has it" in said.err
        assert await place.publish() == Said(0, "the master has the newest list\n", "")


@pytest.mark.attack("stopped-master")
async def test_nodes_become_stale_without_a_stopped_master(
    place: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Connections end without its confirmation; on another host the list must be sent to it."""
    elsewhere = tmp_path / "elsewhere"
    monkeypatch.setattr(staleness, "STALE_GRACE", 5)
    elsewhere.mkdir(mode=0o700)
    (elsewhere / "nodes").mkdir(mode=0o700)
    NodeHome.of(place.root, MASTER).path.rename(elsewhere / "nodes" / "master")
    async with talking_to(place, elsewhere) as (send, talker):
        send(signal.SIGSTOP)
        assert (await place.revoke("ca", "revoke", "/viewer")).code == 3
        await until(lambda: not talker.links, within=90)
        send(signal.SIGCONT)
        assert await place.publish() == Said(0, "the master has the newest list\n", "")
        viewer = NodeHome.of(place.root, "/viewer")
        robot = NodeHome.of(place.root, "/robot")
        await until(lambda: robot.load_revocations() == viewer.load_revocations())
        await until(lambda: not talker.links)


@contextlib.asynccontextmanager
async def talking_to(
    place: Place, home: Path
) -> AsyncIterator[tuple[Callable[[signal.Signals], None], Publisher]]:
    """The first list of the authority is sent to a master on another host."""
    async with master_of(place, home) as send:
        assert (await place.publish()).code == 0
        async with talking(place) as talker:
            yield send, talker
