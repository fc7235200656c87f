"""A robot and an authority in separate processes; besides the network they exchange only what
people see: the picture on the robot's terminal, and six digits.
"""

import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest
import zxingcpp

from ca.certificates import TrustAnchor, from_pem
from tests.support.screen import picture

ROOT: Final = Path(__file__).parents[2]
ROSSEC: Final = str(Path(sys.executable).parent / "rossec")
SECRET: Final = "four random words here"


class Host:
    """A computer with its own ROSSEC_HOME; it shares nothing with the others."""

    def __init__(self, root: Path) -> None:
        root.mkdir(mode=0o700)
        self.root = root
        self.environ = {**os.environ, "ROSSEC_HOME": str(root / "home")}
        self.passphrase = root / "passphrase"
        self.passphrase.touch(0o600)
        self.passphrase.write_text(SECRET)

    def runs(self, *words: str, terminal: str = "") -> subprocess.Popen[str]:
        """Start a command; with `terminal`, on a terminal where a person types this answer."""
        at = [sys.executable, "-m", "tests.support.terminal", terminal, "--"] if terminal else []
        return subprocess.Popen(
            [*at, ROSSEC, *words],
            env=self.environ,
            cwd=ROOT,
            text=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )

    def done(self, *words: str) -> str:
        process = self.runs(*words)
        out, _ = process.communicate(timeout=60)
        assert process.returncode == 0, out
        return out

    def node(self, name: str) -> Path:
        return self.root / "home" / "nodes" / name


@pytest.fixture(scope="module")
def office(tmp_path_factory: pytest.TempPathFactory) -> Host:
    """The authority's host."""
    host = Host(tmp_path_factory.mktemp("hosts") / "office")
    host.done("ca", "init", "home", "--passphrase-file", str(host.passphrase))
    return host


@pytest.fixture
def started() -> Iterator[list[subprocess.Popen[str]]]:
    processes: list[subprocess.Popen[str]] = []
    yield processes
    for process in processes:
        process.kill()
        process.communicate()


def said(process: subprocess.Popen[str], pattern: str) -> str:
    """The output of the process up to the line with `pattern`."""
    assert process.stdout is not None
    lines = []
    for line in process.stdout:
        lines.append(line)
        if re.search(pattern, line):
            return "".join(lines)
    pytest.fail("".join(lines))


@pytest.mark.parametrize(
    ("address", "at_a_terminal"), [("127.0.0.1", True), ("::1", False)], ids=["IPv4", "IPv6"]
)
def test_a_node_is_enrolled_from_the_picture_on_the_terminal(
    office: Host, tmp_path: Path, started: list[subprocess.Popen[str]], address: str, at_a_terminal: bool
) -> None:
    robot, name = Host(tmp_path / "robot"), f"/robot{'4' if at_a_terminal else '6'}"
    node = robot.runs("node", "enroll", name, "--address", address, terminal="y" * at_a_terminal)
    started.append(node)
    screen = said(node, "waits at")

    shown = re.findall("^(\x1b.*)$", screen, re.MULTILINE)
    texts = {
        code.text
        for dark in (True, False)
        for code in zxingcpp.read_barcodes(picture("\n".join(shown), dark=dark))
    }
    (text,) = texts
    authority = office.runs("ca", "enroll", text, "--yes", "--passphrase-file", str(office.passphrase))
    started.append(authority)
    introduction = said(authority, "^digits")
    assert f"spiffe://home{name} asks for an identity" in introduction
    digits = introduction.splitlines()[-1].removeprefix("digits ")
    if not at_a_terminal:
        assert f"digits {digits}" in said(node, "^digits")
        assert robot.done("node", "confirm", name, digits) == f"{name} is enrolled\n"

    out, _ = authority.communicate(timeout=60)
    assert authority.returncode == 0, out
    assert out.endswith(f"enrolled {name}\n")
    out, _ = node.communicate(timeout=60)
    assert node.returncode == 0, out
    assert f"{name} is enrolled in home" in out
    if at_a_terminal:
        assert f"digits {digits}" in out
    check_identity(office, robot, name)


def check_identity(office: Host, robot: Host, name: str) -> None:
    directory = robot.node(name[1:])
    trusted, authority = directory / "ca.pem", office.root / "home" / "ca" / "ca.pem"
    assert trusted.read_bytes() == authority.read_bytes()
    leaf, root = from_pem((directory / "node.pem").read_bytes())
    assert TrustAnchor.load(root).verify([leaf], int(time.time())).name == name
    done = subprocess.run(
        ["openssl", "verify", "-x509_strict", "-CAfile", trusted, directory / "node.pem"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert not (directory / "enrolling.sock").exists()
