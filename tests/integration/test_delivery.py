"""Grants that reach running nodes through the master: the three forms, and a master that is killed.

Every node lives in a ROSSEC_HOME of its own, as on a robot: nothing but the master connects it with
the authority, whose commands are run as a user runs them.
"""

import asyncio
import contextlib
import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from typing import Final

import pytest

from grants import document
from grants.model import Right
from rossec.errors import RossecError
from rossec.net.rpc.calls import RpcClient
from tests.integration.sidecarworld import ROSSEC, Running, wait
from tests.support.attacker import credentials, dial, drafted
from tests.support.caller import Caller
from tests.support.commands import PASSPHRASE
from tests.support.fleet import PROJECT, SECURE
from tests.support.masterprocess import master_process
from tests.support.ports import free_port
from tests.support.site import Site
from tests.support.witness import until

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

_ROSPY_TALKER: Final = """
import rospy
from std_msgs.msg import String
rospy.init_node("talker")
publisher = rospy.Publisher("/words", String, queue_size=10)
print("READY", flush=True)
rate, number = rospy.Rate(10), 0
while not rospy.is_shutdown():
    publisher.publish(f"word {number}")
    number += 1
    rate.sleep()
"""
_BUILTIN_TALKER: Final = """
import asyncio
from rossec.errors import AnswerRefused
from rossec.node import Node
async def main():
    async with Node("/talker") as node:
        print("READY", flush=True)
        while True:
            try:
                publisher = await node.publisher("/words", "std_msgs/String")
                break
            except AnswerRefused:
                await asyncio.sleep(0.1)
        number = 0
        while True:
            publisher.publish(publisher.create(data=f"word {number}"))
            number += 1
            await asyncio.sleep(0.1)
asyncio.run(main())
"""
_LISTENER: Final = """
import asyncio
from rossec.errors import AnswerRefused
from rossec.node import Node
async def main():
    async with Node("/listener") as node:
        print("READY", flush=True)
        while True:
            try:
                subscriber = await node.subscriber("/words", "std_msgs/String")
                break
            except AnswerRefused:
                await asyncio.sleep(0.1)
        async for message in subscriber:
            print("HEARD", message.data, flush=True)
asyncio.run(main())
"""
TALKERS: Final = {
    "builtin": (sys.executable, "-c", _BUILTIN_TALKER),
    "inprocess": (sys.executable, "-c", SECURE + _ROSPY_TALKER),
    "sidecar": (ROSSEC, "run", "--", sys.executable, "-c", _ROSPY_TALKER),
}


class Place:
    """An authority, a master and nodes, each with its own home."""

    def __init__(self, root: Path, stack: contextlib.ExitStack) -> None:
        self.root = root
        self.stack = stack
        self.port = free_port()
        root.mkdir(mode=0o700, exist_ok=True)
        self.secret = root / "passphrase"
        self.secret.write_text(PASSPHRASE)
        self.secret.chmod(0o600)
        self.rossec("office", "ca", "init", "home", "--passphrase-file", str(self.secret))
        self.enroll("/master")

    def home(self, name: str) -> Path:
        path = self.root / name.lstrip("/")
        path.mkdir(mode=0o700, exist_ok=True)
        return path

    def environ(self, name: str) -> dict[str, str]:
        kept = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
        logs = str(self.root)
        return {
            **kept,
            "ROSSEC_HOME": str(self.home(name)),
            "ROS_IP": "127.0.0.1",
            "ROS_MASTER_URI": f"http://127.0.0.1:{self.port}/",
            "ROS_HOME": logs,
            "ROS_LOG_DIR": logs,
            "PYTHONPATH": str(PROJECT),
            "PYTHONUNBUFFERED": "1",
            "PYTHONWARNINGS": "ignore",
        }

    def rossec(self, where: str, *words: str) -> str:
        said = subprocess.run(
            [ROSSEC, *words],
            env=self.environ(where),
            capture_output=True,
            text=True,
            timeout=60,
            stdin=subprocess.DEVNULL,
            check=False,
        )
        assert said.returncode == 0, (words, said.stdout, said.stderr)
        return said.stdout

    def sign(self, *words: str) -> str:
        return self.rossec("office", *words, "--passphrase-file", str(self.secret))

    def enroll(self, name: str) -> None:
        """The node's directory is on its own host, never on the authority's."""
        self.rossec(name, "node", "request", name, "--domain", "home")
        directory = self.home(name) / "nodes" / name.lstrip("/")
        self.sign("ca", "sign", str(directory / "node.csr"), "--yes")
        self.rossec(name, "node", "install", str(directory / "node.pem"), "--yes")

    def start(self, name: str, *command: str) -> Running:
        running = Running(command, self.environ(name))
        self.stack.callback(running.close)
        return running

    def start_master(self) -> Running:
        master = self.start("/master", ROSSEC, "master", "-p", str(self.port))
        master.wait_for("master of home at")
        return master

    def states(self) -> dict[str, str]:
        listed = json.loads(self.rossec("office", "grant", "list", "--json"))
        return {row["node"]: row["state"] for row in listed}

    def grants_of(self, name: str) -> list[Path]:
        return list((self.home(name) / "nodes" / name.lstrip("/") / "grants").glob("*.grant"))


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    with contextlib.ExitStack() as stack:
        yield Place(tmp_path / "place", stack)


@pytest.mark.parametrize("form", TALKERS)
def test_a_running_node_of_each_form_uses_a_grant_that_is_signed_elsewhere(place: Place, form: str) -> None:
    for name in ("/talker", "/listener"):
        place.enroll(name)
    place.start_master()
    place.rossec("office", "ca", "publish")
    listener = place.start("/listener", sys.executable, "-c", _LISTENER)
    talker = place.start("/talker", *TALKERS[form])
    for running in (listener, talker):
        running.wait_for("READY")
    said = place.sign("grant", "sign", "/listener", "--subscribe", "/words")
    assert said.endswith("the master has the grant, and gives it to the node\n")
    time.sleep(1)
    assert "HEARD" not in listener.said
    place.sign("grant", "sign", "/talker", "--publish", "/words")
    listener.wait_for("HEARD word")
    wait(lambda: len(place.grants_of("/talker")) == 1)
    assert place.states() == {"/listener": "held", "/talker": "held"}
    assert talker.process.poll() is None, "without a restart"


def test_a_killed_master_loses_no_deposit_and_a_node_that_was_off_gets_it(place: Place) -> None:
    for name in ("/talker", "/listener"):
        place.enroll(name)
    master = place.start_master()
    place.rossec("office", "ca", "publish")
    place.sign("grant", "sign", "/listener", "--subscribe", "/words")
    place.sign("grant", "sign", "/talker", "--publish", "/words")
    master.end(signal.SIGKILL)
    place.start_master()
    assert place.states() == {"/listener": "waiting", "/talker": "waiting"}
    signed = place.sign("grant", "sign", "/talker", "--publish", "/gone", "--json")
    gone = json.loads(signed)["id"]
    place.sign("grant", "revoke", gone)
    listener = place.start("/listener", sys.executable, "-c", _LISTENER)
    place.start("/talker", *TALKERS["builtin"])
    listener.wait_for("HEARD word")
    assert [path.stem for path in place.grants_of("/talker")] != [gone]
    assert len(place.grants_of("/talker")) == 1, "what was withdrawn is not delivered"
    shutil.rmtree(place.home("/talker") / "nodes" / "talker" / "grants")
    listed = json.loads(place.rossec("office", "grant", "list", "/talker", "--json"))
    assert [row["state"] for row in listed] == ["held", "revoked"]


async def deposit_until_killed(office: Caller, acknowledged: list[bytes]) -> None:
    """Deposit grants for one node after another until the master is gone."""
    with contextlib.suppress(RossecError):
        for number in range(10**6):
            data = drafted_grant(office.site, f"/robot{number % 50}")
            if (await office("rossec.depositGrants", [data]))[2] == [""]:
                acknowledged.append(data)


def drafted_grant(site: Site, name: str) -> bytes:
    draft = drafted(site, "/robot", "/p", Right.PUBLISH)
    holder = sha256(name.encode()).digest()
    return document.sign(site.authority.signer, dataclasses.replace(draft, subject=name, holder=holder))


async def test_a_master_killed_while_grants_are_deposited_has_all_it_acknowledged(tmp_path: Path) -> None:
    async with master_process(tmp_path / "site") as master:
        site, acknowledged = master.site, list[bytes]()
        site.enroll("/robot")
        own = credentials(site, "/ca")
        await master.start()
        office = Caller(site, "/ca", RpcClient(await dial(master.uri, own)))
        async with asyncio.TaskGroup() as group:
            group.create_task(deposit_until_killed(office, acknowledged))
            await until(lambda: len(acknowledged) > 100, within=30)
            await master.kill()
        await master.start()
        again = Caller(site, "/ca", RpcClient(await dial(master.uri, own)))
        entries = [document.grant_id(data) + document.peek(data).holder for data in acknowledged]
        for begin in range(0, len(entries), 256):
            states = (await again("rossec.deliveryStates", entries[begin : begin + 256]))[2]
            assert set(states) == {"waiting"}
        repeated = (await again("rossec.depositGrants", acknowledged[:64]))[2]
        assert set(repeated) == {""}, "and nothing twice"
        await again.client.close()
