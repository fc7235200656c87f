"""Two authorities with shells of their own, for the tests of `rossec domain`."""

import json
from pathlib import Path
from typing import Any

import pytest

from ca.domains import Anchors, DomainList
from rossec.authority.home import AuthorityHome
from tests.support.commands import Said, Shell

NOBODY = ("--master", "http://127.0.0.1:1")


class Neighbours:
    """The home, in whose shell commands run, and a hospital that has made a bundle."""

    def __init__(self, shell: Shell, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.shell = shell
        self.hospital = Shell(tmp_path / "hospital", capsys)
        assert self.hospital.unlocked("ca", "init", "hospital.example").code == 0
        self.bundle = tmp_path / "hospital.bundle"
        said = self.make_bundle("--names", "/rounds/**", "--at", "http://10.0.0.7:11311")
        assert said.code == 0, said
        self.fingerprint, self.code = (
            next(line for line in said.out.splitlines() if line.startswith(word))[len(word) :]
            for word in ("fingerprint ", "code ")
        )

    def make_bundle(self, *options: str) -> Said:
        return self.hospital.unlocked("domain", "bundle", "--out", str(self.bundle), *options)

    def accept(self, *options: str) -> Said:
        """Accept the bundle, without a master."""
        return self.shell.unlocked("domain", "accept", str(self.bundle), "--yes", *NOBODY, *options)

    def change(self, *arguments: str) -> Said:
        """`rossec domain ARGUMENTS` with the key, without a master."""
        return self.shell.unlocked("domain", *arguments, *NOBODY)

    def shown(self, label: str = "hospital") -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.shell("domain", "show", label, "--json").out)
        return found

    @property
    def home(self) -> AuthorityHome:
        return AuthorityHome.at(self.shell.root)

    def listed(self) -> DomainList:
        """The newest list; a verifier takes it."""
        found = self.home.domain_list()
        assert found is not None
        Anchors(self.home.anchor()).update(found[0])
        return found[1]
