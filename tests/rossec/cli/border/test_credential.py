"""`rossec border credential`."""

import sys
from pathlib import Path

import pytest

from ca.keys.signing import thumbprint
from ca.things import read_ccs
from rossec.home import NodeHome
from rossec.saved_statements import ThingFiles
from tests.support.commands import Shell, refused


def test_things_know_the_router_by_a_key_of_its_own(shell: Shell, tmp_path: Path) -> None:
    shell.enroll("/border")
    file = tmp_path / "border.ccs"
    said = shell("border", "credential", str(file))
    assert said.code == 0, said
    assert said.out.startswith("credential of /border: fingerprint ")
    assert shell("border", "credential", str(file)).out == said.out
    key = ThingFiles(NodeHome.of(shell.root, "/border")).router_key()
    assert read_ccs(file.read_bytes()).thumbprint == thumbprint(key.public_key())


def test_it_needs_an_identity_and_the_extra(
    shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = str(tmp_path / "border.ccs")
    refused(shell("border", "credential", file), "/border has no ca.pem", "node request /border")
    monkeypatch.setitem(sys.modules, "rossec.border.handshakes", None)
    refused(shell("border", "credential", file), "not installed", "rossec[constrained]")
    assert not Path(file).exists()
