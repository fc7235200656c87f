"""A home that trusts a hospital, whose robot has an identity."""

from pathlib import Path

import pytest

from tests.rossec.cli.domain.sites import Neighbours
from tests.support.commands import Shell


@pytest.fixture
def visit(
    empty: Shell, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Neighbours:
    """The hospital's `/rounds/robot3` is enrolled there; the home admits `/rounds/*`."""
    monkeypatch.setattr("ca.keys.passphrases._N", 16)  # the passphrase is not under test
    assert empty.unlocked("ca", "init", "home").code == 0
    made = Neighbours(empty, tmp_path, capsys)
    made.accept("--admit", "/rounds/*", "--for", "30d")
    for name in ("/rounds/robot3", "/rounds/robot7", "/kitchen"):
        enroll(made.hospital, name)
    return made


def enroll(shell: Shell, name: str) -> None:
    """A node of the hospital."""
    assert shell("node", "request", name, "--domain", "hospital.example").code == 0
    request = str(shell.node(name) / "node.csr")
    assert shell.unlocked("ca", "sign", request, "--yes").code == 0
    assert shell("node", "install", str(shell.node(name) / "node.pem"), "--yes").code == 0
