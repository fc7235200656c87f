"""A console adds a node that is a process of its own: `rossec node enroll`, and `node confirm`."""

import asyncio
import os
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from ca.certificates import TrustAnchor, from_pem
from ca.enrollment import qr
from rossec.console.enrollments import Enrollments, RecordedName, Stage
from rossec.console.server.supervisor import ScannerSupervisor
from rossec.console.server.web import ScannerClient
from tests.rossec.console.test_enrollment import SITE, Adding, Service, node, waiting
from tests.rossec.console.test_enrollments import Changes
from tests.support.enrolling import clock

ROSSEC: Final = str(Path(sys.executable).parent / "rossec")


class Node:
    """A node's host, with its own ROSSEC_HOME."""

    def __init__(self, home: Path, name: str) -> None:
        self.home, self.name = home, name
        self.environ = {**os.environ, "ROSSEC_HOME": str(home)}
        self.process = self._start("node", "enroll", name, "--address", "127.0.0.1")

    def _start(self, *words: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [ROSSEC, *words],
            env=self.environ,
            text=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )

    def code(self) -> str:
        """The text below the code on its terminal."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if found := re.search(r"ROSSEC:[0-9A-Z $%*+./:-]+", line):
                return found[0].strip()
        pytest.fail("the node shows no code")

    def confirm(self, digits: str) -> str:
        out, _ = self._start("node", "confirm", self.name, digits).communicate(timeout=60)
        return out

    def ends(self) -> str:
        out, _ = self.process.communicate(timeout=60)
        return out


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Node]:
    found = Node(tmp_path / "home", "/fridge")
    yield found
    found.process.kill()
    found.process.communicate()


async def scanned(picture: bytes) -> str | None:
    """The code in a picture, as the console reads it: in a confined process."""
    ours, theirs = socket.socketpair()
    client = ScannerClient(theirs)
    async with asyncio.TaskGroup() as group:
        group.create_task(ScannerSupervisor(ours).run())
        found = await client.read(picture)
        await client.close()
    return found


async def test_a_node_is_added_from_the_picture_of_its_code(robot: Node) -> None:
    text = await scanned(qr.png(await asyncio.to_thread(robot.code)))
    assert text is not None
    changes, service = Changes(), Service()
    enrollments = Enrollments(service, "home", clock, changes)
    number = enrollments.begin(text)
    found = enrollments.get(number)
    await changes.until(found, Stage.COMPARED)
    assert (found.core.request.name, found.known) == ("/fridge", RecordedName.NEW)

    service.answers = [waiting(), Adding.signed_for(found.core)]  # the key is unlocked meanwhile
    enrollments.approved(number, waiting())
    await changes.until(found, Stage.DIGITS)
    wrong = await asyncio.to_thread(robot.confirm, "000000")
    assert "not the digits" in wrong
    assert found.stage is Stage.DIGITS
    said = await asyncio.to_thread(robot.confirm, found.core.digits)
    assert said == "/fridge is enrolled\n"
    await changes.until(found, Stage.ENROLLED)
    await enrollments.close()

    assert "/fridge is enrolled in home" in await asyncio.to_thread(robot.ends)
    leaf, root = from_pem((robot.home / "nodes" / "fridge" / "node.pem").read_bytes())
    assert root == SITE.root
    assert TrustAnchor.load(root).verify([leaf], clock()).name == "/fridge"


async def test_a_node_that_is_ended_at_the_node_is_told(robot: Node) -> None:
    text = await asyncio.to_thread(robot.code)
    changes = Changes()
    known = node(b"another key")._replace(name="/fridge")
    enrollments = Enrollments(Service((known,)), "home", clock, changes)
    number = enrollments.begin(text)
    found = enrollments.get(number)
    await changes.until(found, Stage.COMPARED)
    assert found.is_other_key
    enrollments.approved(number, Adding.signed_for(found.core))
    await changes.until(found, Stage.DIGITS)
    robot.process.terminate()
    await changes.until(found, Stage.FAILED)
    assert found.error is not None
    assert "node" in str(found.error)
    await enrollments.close()
