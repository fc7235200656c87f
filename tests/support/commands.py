"""Run the command line in process, as a user would, in a home of its own."""

import os
from dataclasses import dataclass
from pathlib import Path

import pytest

from rossec.cli.main import run

PASSPHRASE = "four random words here"


@dataclass(frozen=True)
class Said:
    """The result of a command."""

    code: int
    out: str
    err: str


class Shell:
    """A user's shell with ROSSEC_HOME set and a passphrase in a file."""

    def __init__(self, root: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.root = root
        self._capsys = capsys
        root.mkdir(mode=0o700, parents=True)
        self.secret = root / "passphrase"
        self.secret.write_text(PASSPHRASE + "\n")
        self.secret.chmod(0o600)
        self.environ = {**os.environ, "ROSSEC_HOME": str(root), "ROS_IP": "127.0.0.1"}

    def __call__(self, *arguments: str) -> Said:
        """Run `rossec ARGUMENTS`."""
        self._capsys.readouterr()
        code = run(list(arguments), self.environ)
        out, err = self._capsys.readouterr()
        assert "Traceback" not in err
        return Said(code, out, err)

    def unlocked(self, *arguments: str) -> Said:
        """Run a command that needs the authority's key."""
        return self(*arguments, "--passphrase-file", str(self.secret))

    def node(self, name: str) -> Path:
        """Directory of a node."""
        return self.root / "nodes" / name.lstrip("/").replace("/", ".")

    def enroll(self, name: str, *options: str) -> None:
        """Request, sign and install the identity of a node; `options`: `--anonymous`."""
        assert self("node", "request", name, *options).code == 0
        request = str(self.node(name) / "node.csr")
        assert self.unlocked("ca", "sign", request, "--yes", *options).code == 0
        assert self("node", "install", str(self.node(name) / "node.pem"), "--yes").code == 0


def refused(said: Said, error: str, hint: str = "", code: int = 1) -> None:
    """Assert that a command failed with an error of rossec."""
    assert said.code == code, said
    lines = said.err.splitlines()
    assert lines[0].startswith("rossec: error: "), said.err
    assert error in lines[0], said.err
    if hint:
        assert lines[1].startswith("rossec: hint: "), said.err
        assert hint in lines[1], said.err
