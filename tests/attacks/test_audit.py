"""An attacker that can write the audit removes lines; `rossec audit --verify` detects it."""

import json
import logging
from pathlib import Path

import pytest

from ca.keys.signing import KeySigner
from rossec.host.audit import AuditFile, mark, with_hash
from rossec.ros.names import MASTER
from tests.support.commands import Shell, refused
from tests.support.pki import new_signer
from tests.support.site import Site

pytestmark = pytest.mark.attack("cut-audit")


class Audit:
    """The audit of a master, in its home, and the command that verifies it."""

    def __init__(self, shell: Shell, signer: KeySigner) -> None:
        self.shell = shell
        self.path = shell.node(MASTER) / "audit.log"
        self.file = AuditFile(self.path, lambda: 1000.0, signer)

    def write(self, *texts: str) -> None:
        for text in texts:
            self.file.emit(logging.makeLogRecord({"msg": text}))

    def keep(self, *lines: str) -> None:
        self.path.write_text("".join(f"{line}\n" for line in lines))

    @property
    def lines(self) -> list[str]:
        return self.path.read_text().splitlines()


@pytest.fixture
def audit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Audit:
    shell = Shell(tmp_path / "home", capsys)
    audit = Audit(shell, Site(shell.root).enroll(MASTER).signer())
    audit.write("one", "two", "three")
    return audit


def test_an_intact_audit_verifies(audit: Audit) -> None:
    said = audit.shell("audit", "--verify")
    assert (said.code, len(said.err.splitlines())) == (0, 1)


@pytest.mark.parametrize("cut", [1, 2, 3])
def test_an_audit_without_its_beginning(audit: Audit, cut: int) -> None:
    audit.keep(*audit.lines[cut:])
    refused(audit.shell("audit", "--verify"), "the beginning of the audit is missing", "--after")


def test_another_beginning_by_another_key(audit: Audit) -> None:
    rest = [json.loads(line) for line in audit.lines[2:]]
    before = rest[0]["before"]
    forged = with_hash(mark(new_signer(), before, 1000.0), before)
    audit.keep(json.dumps(forged), *audit.lines[2:])
    refused(audit.shell("audit", "--verify"), "before line 2 of the audit something is missing")
    audit.keep(json.dumps(forged))
    refused(audit.shell("audit", "--verify"), "begins with a line of another key", "--key")


def test_a_line_of_the_master_before_the_remainder(audit: Audit) -> None:
    lines = audit.lines
    audit.keep(lines[0], *lines[2:])
    refused(audit.shell("audit", "--verify"), "before line 2 of the audit something is missing")
    begun = json.loads(lines[0])
    begun["before"] = json.loads(lines[2])["before"]
    del begun["hash"]
    audit.keep(json.dumps(with_hash(begun, begun["before"])), *lines[2:])
    refused(audit.shell("audit", "--verify"), "before line 2 of the audit something is missing")


def test_a_rotated_audit_verifies(audit: Audit) -> None:
    older = audit.path.with_name("audit.log.1")
    audit.path.rename(older)
    audit.write("four")
    last = json.loads(older.read_text().splitlines()[-1])["hash"]
    whole = audit.shell("audit", "--verify", str(older), str(audit.path))
    assert (whole.code, len(whole.err.splitlines())) == (0, 1)
    alone = audit.shell("audit", "--verify")
    assert alone.code == 0
    assert f"it continues from {last}, not among these files" in alone.err
    noted = audit.shell("audit", "--verify", "--after", last)
    assert (noted.code, len(noted.err.splitlines())) == (0, 1)
    audit.keep(*audit.lines[1:])
    refused(audit.shell("audit", "--verify"), "the beginning of the audit is missing")
