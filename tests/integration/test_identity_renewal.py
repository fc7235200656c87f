"""Identities renewed by the authority's service through the master: real processes, a real node.

The node's home is another than the authority's, as on another machine.
"""

import asyncio
import contextlib
import json
import logging
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from functools import partial
from pathlib import Path

import pytest

from rossec.clock import now
from rossec.home import NodeHome
from rossec.node import Node
from rossec.participant import renewals
from tests.support.commands import PASSPHRASE
from tests.support.ports import free_port
from tests.support.serviceprocess import ServiceProcess
from tests.support.site import DAY
from tests.support.witness import until

AGED, LIFE = 25 * DAY, 30 * DAY  # the authority was made so long ago


class Fleet:
    """A master and an authority's service, started by the test."""

    def __init__(self, root: Path) -> None:
        self.service = ServiceProcess(root / "site", now() - AGED)
        self.hosts = root / "hosts"
        self.port = free_port()
        self.service.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{self.port}/"
        self.master: subprocess.Popen[str] | None = None

    def start_master(self) -> None:
        self.master = subprocess.Popen(
            [sys.executable, "-I", "-m", "rossec", "master", "--json"],
            env=self.service.environ,
            text=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
        )
        assert self.master.stdout is not None
        assert "ready" in json.loads(self.master.stdout.readline())

    def serve(self, *options: str) -> None:
        self.service.start("--join-address", f"127.0.0.1:{free_port()}", *options)

    def enroll(self, name: str, began: int, life: int) -> NodeHome:
        """A node whose identity was signed at `began`, for `life` seconds."""
        home = NodeHome.of(self.hosts / name.strip("/"), name)
        home.path.parent.parent.mkdir(parents=True, mode=0o700)
        home.create_request("home")
        authority = self.service.home.unlock(PASSPHRASE)
        with contextlib.closing(authority.store):
            home.install(authority.issue(home.request(), began, life), now())
        return home

    def node(self, name: str) -> Node:
        home = str(self.hosts / name.strip("/"))
        uri = self.service.environ["ROS_MASTER_URI"]
        environ = {"ROSSEC_HOME": home, "ROS_IP": "127.0.0.1", "ROS_MASTER_URI": uri}
        return Node(name, environ=environ)

    def close(self) -> None:
        self.service.close()
        if self.master is not None:
            self.master.kill()
            self.master.wait()
            assert self.master.stdout is not None
            self.master.stdout.close()


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    fleet = Fleet(tmp_path)
    yield fleet
    fleet.close()


@contextlib.asynccontextmanager
async def running(fleet: Fleet, name: str) -> AsyncIterator[Node]:
    async with fleet.node(name) as node:
        yield node


async def test_a_node_is_renewed_as_soon_as_somebody_unlocks_the_key(
    fleet: Fleet, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(renewals, "LONGEST_PAUSE", 1)
    monkeypatch.setattr(renewals, "FIRST_PAUSE", 1)
    caplog.set_level(logging.INFO, "rossec.node")
    home = fleet.enroll("/robot", now() - AGED, LIFE)
    before = home.identity(now())
    fleet.start_master()
    async with running(fleet, "/robot") as node:
        await until(lambda: "service does not run" in caplog.text, within=30)
        await asyncio.to_thread(fleet.serve, "--locked")
        locked = "the authority's key is locked (where the authority is: rossec ca unlock --for 8h)"
        await until(lambda: locked in caplog.text, within=60)
        assert "the identity ends in " in caplog.text
        secret = str(fleet.service.secret)
        unlock = ("ca", "unlock", "--passphrase-file", secret)
        await asyncio.to_thread(fleet.service.run, *unlock)
        await until(lambda: home.identity(now()).not_after > before.not_after, within=90)
        after = home.identity(now())
        assert (after.name, after.thumbprint) == ("/robot", before.thumbprint)
        assert after.not_after <= now() + LIFE
        assert node.credentials.current.chain == home.credentials().chain
        assert "signs a certificate of /robot" in fleet.service.audit()
        assert "for a node that renews its identity" in fleet.service.audit()
    listed = json.loads(fleet.service.run("ca", "list", "--json").stdout)
    assert [row["ends_soon"] for row in listed if row["name"] == "/robot"] == [False]


async def test_lives_of_seconds_go_on_and_the_master_is_renewed_too(fleet: Fleet) -> None:
    """The master's own identity is due; the node's becomes so while it runs."""
    master = NodeHome.of(fleet.service.root, "/master")
    ends = master.identity(now()).not_after
    home = fleet.enroll("/robot", now(), 24)
    first = home.identity(now()).not_after
    fleet.start_master()
    fleet.serve("--apply")
    async with running(fleet, "/robot"):
        await until(lambda: home.identity(now()).not_after > first, within=30)
        await until(lambda: master.identity(now()).not_after > ends, within=30)


async def test_what_has_ended_comes_back_with_its_key_and_what_is_revoked_does_not(
    fleet: Fleet, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    home = fleet.enroll("/robot", now(), 24)
    stolen = fleet.enroll("/stolen", now(), 24)
    key, ends = home.identity(now()).thumbprint, home.identity(now()).not_after
    fleet.start_master()
    fleet.serve("--no-renewals")
    run = fleet.service.run
    out = ("--out", str(tmp_path / "robot.pem"))
    async with running(fleet, "/robot") as node:
        await asyncio.to_thread(run, "ca", "revoke", "/stolen")
        await until(lambda: now() > ends, within=60)
        ended = "no answer from the master: the identity of /robot ended on 20"
        await until(lambda: ended in caplog.text, within=60)
        assert "rossec ca renew --expired /robot, then on its machine" in caplog.text
        refused = await asyncio.to_thread(partial(run, "ca", "renew", "/robot", check=False))
        assert "rossec ca renew --expired /robot" in refused.stderr
        await asyncio.to_thread(run, "ca", "renew", "--expired", "/robot", *out)
        home.install((tmp_path / "robot.pem").read_bytes(), now())
        session = node._membership.session
        await until(lambda: session.is_open, within=60)
    assert home.identity(now()).thumbprint == key
    for words in (("ca", "renew", "--expired", "/stolen"), ("ca", "renew", "/stolen")):
        refused = await asyncio.to_thread(partial(run, *words, check=False))
        assert (refused.returncode, "is revoked" in refused.stderr) == (1, True)
    assert stolen.path.exists()
