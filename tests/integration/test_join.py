"""Robots join a running authority: each command is a process with a ROSSEC_HOME of its own.

They share nothing but the network and the line that `rossec ca invite` prints.
"""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import pytest

from ca.enrollment import invitation
from rossec.host.callers import descendants, parents
from tests.integration.sidecarworld import wait
from tests.support.ports import free_port

ROSSEC: Final = str(Path(sys.executable).parent / "rossec")
SECRET: Final = "four random words here"
PATIENCE: Final = 60


class Host:
    """A computer with its own ROSSEC_HOME."""

    def __init__(self, root: Path) -> None:
        root.mkdir(mode=0o700)
        self.root = root
        self.environ = {**os.environ, "ROSSEC_HOME": str(root), "ROS_IP": "127.0.0.1"}

    def start(self, *words: str) -> subprocess.Popen[str]:
        pipe = subprocess.PIPE
        return subprocess.Popen(
            [ROSSEC, *words], env=self.environ, text=True, stdin=pipe, stdout=pipe, stderr=pipe
        )

    def run(self, *words: str, given: str = "", code: int = 0) -> str:
        process = self.start(*words)
        out, err = process.communicate(given, timeout=PATIENCE)
        assert process.returncode == code, out + err
        return out + err


class Office(Host):
    """The authority's host; its service listens on a port that was free."""

    def __init__(self, root: Path) -> None:
        super().__init__(root)
        secret = root / "passphrase"
        secret.touch(0o600)
        secret.write_text(SECRET)
        self.key = ("--passphrase-file", str(secret))
        self.run("ca", "init", "home", *self.key)
        self.port = free_port()

    @contextmanager
    def serving(self, *options: str) -> Iterator[subprocess.Popen[str]]:
        where = f"127.0.0.1:{self.port}"
        words = ("ca", "serve", "--unlock-for", "0", "--join-address", where, "--json", *self.key)
        process = self.start(*words, *options)
        try:
            assert process.stdout is not None
            assert json.loads(process.stdout.readline())["join_port"] == self.port
            yield process
        finally:
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=PATIENCE)

    def invite(self, pattern: str, uses: int) -> str:
        process = self.start(
            "ca", "invite", pattern, "--uses", str(uses), "--address", f"127.0.0.1:{self.port}"
        )
        out, err = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, err
        return out

    def joined(self, code: str) -> list[str]:
        """The names that joined, as the record has them."""
        wanted = invitation.parse(code).id.hex()
        found = json.loads(self.run("ca", "invitations", "--all", "--json"))
        [listed] = [each for each in found if each["id"] == wanted]
        return [use["name"] for use in listed["joined"]]


@pytest.fixture
def office(tmp_path: Path) -> Office:
    return Office(tmp_path / "office")


@pytest.fixture
def robots(tmp_path: Path) -> list[tuple[str, Host]]:
    return [(f"/fleet/r{number}", Host(tmp_path / f"r{number}")) for number in range(6)]


def test_robots_join_at_the_same_time(office: Office, robots: list[tuple[str, Host]]) -> None:
    with office.serving():
        code = office.invite("/fleet/*", len(robots))
        started = [(robot.start("node", "join", "--name", name)) for name, robot in robots]
        for process in started:
            _, err = process.communicate(code, timeout=PATIENCE)
            assert process.returncode == 0, err
        assert sorted(office.joined(code)) == [name for name, _ in robots]
        late = Host(office.root.with_name("late"))
        assert "is used up" in late.run("node", "join", "--name", "/fleet/x", given=code, code=1)
        name, robot = robots[0]
        again = robot.run("node", "join", "--name", name, given=code)
        assert "is enrolled already" in again
    assert f"{name} of home until" in robot.run("node", "show", name)
    office.run("ca", "log", "verify")


def test_a_join_waits_while_the_authority_is_locked(office: Office, tmp_path: Path) -> None:
    robot = Host(tmp_path / "robot")
    with office.serving():
        code = office.invite("/robot", 1)
        office.run("ca", "lock")
        said = robot.run("node", "join", given=code, code=5)
        assert "the authority is locked" in said
        assert office.joined(code) == []
        office.run("ca", "unlock", *office.key)
        assert "/robot is enrolled until" in robot.run("node", "join", given=code)


def processes_of(service: subprocess.Popen[str]) -> list[int]:
    return descendants(parents(), service.pid)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_robot_is_named_by_the_rules_and_no_process_is_left(
    office: Office, tmp_path: Path, number: signal.Signals
) -> None:
    robot, meta, rules = Host(tmp_path / "robot"), tmp_path / "lamp.xml", tmp_path / "names.xsl"
    meta.write_text("<node><group>lamps</group><owner>ann</owner><name>desk</name></node>")
    rules.write_text(office.run("namespace", "rules"))
    with office.serving("--rules", str(rules)) as service:
        code = office.invite("/lamps/**", 1)
        said = robot.run("node", "join", "--meta", str(meta), given=code)
        assert "/lamps/ann/desk is enrolled until" in said
        children = processes_of(service)
        assert len(children) >= 2, "the network's process, and that for rules"
        service.send_signal(number)
        service.wait(PATIENCE)
        wait(lambda: not set(children) & set(parents()))
    with office.serving():
        other = Host(tmp_path / "other")
        code = office.invite("/lamps/**", 1)
        said = other.run("node", "join", "--meta", str(meta), given=code, code=1)
        assert "the authority has no rules that give names" in said


def test_a_service_that_is_killed_loses_and_doubles_nothing(
    office: Office, robots: list[tuple[str, Host]]
) -> None:
    with office.serving() as service:
        code = office.invite("/fleet/*", len(robots))
        started = [robot.start("node", "join", "--name", name) for name, robot in robots]
        first = started[0]
        first.communicate(code, timeout=PATIENCE)
        service.kill()
        for process in started[1:]:
            process.communicate(code, timeout=PATIENCE)
    with office.serving():
        for name, robot in robots:
            robot.run("node", "join", "--name", name, given=code)
        assert sorted(office.joined(code)) == [name for name, _ in robots]
    office.run("ca", "log", "verify")
