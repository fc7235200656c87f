"""An authority that has used everything is backed up, comes back, and goes on."""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from ipaddress import ip_address
from pathlib import Path

import pytest

from ca.certificates import from_pem
from grants import document
from rossec.authority import backup as backup_files
from rossec.authority import invitations, renewals
from rossec.authority.backup import back_up, restore
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.messages import SOCKET
from rossec.authority.service import AuthorityService
from rossec.console.listening import only_console, write_address
from rossec.console.tls import certificates as tls
from rossec.saved_statements import DomainFiles
from tests.rossec.cli.domain.sites import Neighbours
from tests.rossec.cli.grant.conftest import enroll
from tests.support.commands import PASSPHRASE, Shell

NOBODY = ("--master", "http://127.0.0.1:1")
POLICY = """rossec: 1
robot: everything
rules:
  - {id: r, why: a test, who: /robot, allow: {subscribe: [/scan]}}
"""


@pytest.fixture
def used(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Shell:
    """The home of an authority in which every part has written its files."""
    monkeypatch.setattr("ca.keys.passphrases._N", 16)  # the passphrase is not under test
    monkeypatch.setattr("ca.keys.passphrases._N", 16)
    shell = Shell(tmp_path / "home", capsys)
    assert shell.unlocked("ca", "init", "home", "--master").code == 0
    neighbours = Neighbours(shell, tmp_path, capsys)
    neighbours.accept("--admit", "/rounds/*", "--for", "30d")
    enroll(neighbours.hospital, "/rounds/robot3")
    shell.enroll("/robot")
    (shell.root / "ca" / "policy.yaml").write_text(POLICY)
    (shell.root / "ca" / "policy.yaml").chmod(0o600)
    assert shell("grant", "request", "/robot", "--subscribe", "/scan", "--why", "x").code == 0
    shell.unlocked("master", "delegate", "--for", "30d", *NOBODY)
    with serving(shell):
        assert shell.unlocked("ca", "refresh", *NOBODY).code == 3
    carry(shell, neighbours)
    of_the_own_node(shell, neighbours)
    of_the_console(shell.root / "ca")
    invitations.invite(
        AuthorityHome.at(shell.root), "/fleet/*", 2, int(time.time()) + 600, "127.0.0.1:9", int(time.time())
    )
    return shell


@contextmanager
def serving(shell: Shell) -> Iterator[None]:
    """With its service: socket, lock, audit."""
    options = ("--no-network", "--json", "--passphrase-file", str(shell.secret))
    process = subprocess.Popen(
        [sys.executable, "-I", "-m", "rossec", "ca", "serve", *options],
        env=shell.environ,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    with process.stdout:
        assert process.stdout.readline()
        try:
            yield
        finally:
            process.kill()
            process.wait(30)


def carry(shell: Shell, neighbours: Neighbours) -> None:
    """A grant that somebody carries to another domain."""
    out = shell.root / "visit.grant"
    certificate = str(neighbours.hospital.node("/rounds/robot3") / "node.pem")
    option = ("--subscribe", "/robot/pose", "--certificate", certificate, "--out", str(out))
    assert shell.unlocked("grant", "sign", "hospital:/rounds/robot3", *option).code == 0
    service = AuthorityService(shell.root, lambda: PASSPHRASE, lambda _: None)
    assert service.grants.deposit([out.read_bytes()]) == []
    service.close()


def of_the_own_node(shell: Shell, neighbours: Neighbours) -> None:
    """Lists, keys and a grant of `/ca`."""
    home = AuthorityHome.at(shell.root)
    node, found = home.node(), home.domain_list()
    assert found is not None
    node.save_revocations(home.revocation_list())
    node.save_entries(b"entries")
    node.filter_key("ward")
    node.add_grant(b"g" * 16, b"grant")
    saved, hospital = DomainFiles(node, home.anchor()), AuthorityHome.at(neighbours.hospital.root)
    saved.save_domains(found[0])
    saved.save_foreign(hospital.anchor(), hospital.revocation_list())


def of_the_console(directory: Path) -> None:
    """Its lock, its address, and its TLS authority; it was killed."""
    with only_console(directory):
        pass
    write_address(directory, "http://localhost:7411")
    tls.renew(directory / tls.DIRECTORY, "rossec.local", ip_address("127.0.0.1"), int(time.time()))


def files_of(directory: Path) -> set[str]:
    return {str(path.relative_to(directory)) for path in directory.rglob("*") if path.is_file()}


def test_every_file_of_a_home_that_used_all_is_declared_once(used: Shell) -> None:
    directory = used.root / "ca"
    found = files_of(directory)
    for part in ("node/foreign", "node/filters", "console/tls", "outgoing", "delegations", "inbox"):
        assert any(name.startswith(part) for name in found), part
    assert {"audit.log", "service.lock", "policy.yaml", "console/lock", "ca.db"} <= found
    assert backup_files.undeclared(directory) == []
    assert (directory / SOCKET).exists()
    for name in found:
        assert [each for each in backup_files.OWNED if each.names(name)], name


def test_it_is_backed_up_comes_back_and_goes_on(
    used: Shell, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    backup, listed = str(tmp_path / "backup"), tmp_path / "newest"
    said = used.unlocked("ca", "backup", backup)
    assert said.code == 0, said
    assert "left out" not in said.err
    listed.write_bytes(AuthorityHome.at(used.root).revocation_list())
    domains = used.root / "ca" / "node" / "domains.cose"
    before = {name: (used.root / "ca" / name).read_bytes() for name in files_of(used.root / "ca")}
    new = Shell(tmp_path / "new", capsys)
    again = ("--list", str(listed), "--domains", str(domains))
    said = new.unlocked("ca", "restore", backup, *again)
    assert said.code == 0, said
    there = new.root / "ca"
    kept = backup_files.kept(there)
    assert {name: before[name] for name in kept} == kept
    assert {name.partition("/")[0] for name in before} - {
        name.partition("/")[0] for name in files_of(there)
    } <= {"audit.log", "service.lock", "console", "ca.db-wal", "ca.db-shm"}
    home = AuthorityHome.at(new.root)
    assert list((there / "delegations").glob("*.cose"))
    assert home.node().filter_key("ward") == AuthorityHome.at(used.root).node().filter_key("ward")
    new.enroll("/lamp")
    assert new.unlocked("grant", "decide", *NOBODY).code in {0, 3}
    option = ("--subscribe", "/scan", "--for", "1d", "--out", str(tmp_path / "g"))
    assert new.unlocked("grant", "sign", "/lamp", *option).code == 0
    assert document.peek((tmp_path / "g").read_bytes()).subject == "/lamp"
    assert new.unlocked("ca", "revoke", "/robot", *NOBODY).code == 3
    assert new("ca", "log", "verify").code == 0
    assert new("domain", "list").out.strip()
    with serving(new):
        assert new.unlocked("ca", "refresh", *NOBODY).code == 3


def test_it_is_restored_over_itself_while_it_is_used(used: Shell, tmp_path: Path) -> None:
    backup = str(tmp_path / "backup")
    assert used.unlocked("ca", "backup", backup).code == 0
    over = ("ca", "restore", backup, "--over", "home", "--without-list")
    assert used.unlocked(*over).code == 0
    assert backup_files.undeclared(used.root / "ca") == []
    assert used("ca", "log", "verify").code == 0
    used.enroll("/lamp")


def test_an_intermediate_has_its_files_in_a_backup(used: Shell, tmp_path: Path) -> None:
    place = tmp_path / "host"
    request = renewals.begin(place, "home", PASSPHRASE)
    carried, bundle = tmp_path / "host.csr", tmp_path / "host.pem"
    carried.write_bytes(request.read_bytes())
    sign = ("ca", "intermediate", "sign", str(carried), "--may", "enroll", "--yes")
    assert used.unlocked(*sign).code == 0
    renewals.install(place, bundle.read_bytes(), PASSPHRASE, int(time.time()))
    assert backup_files.undeclared(place / "ca") == []

    data = back_up(AuthorityHome(place / "ca"), PASSPHRASE)
    done = restore(tmp_path / "again", data, PASSPHRASE, int(time.time()), needs_list=True)
    assert done.home.intermediate() == from_pem(bundle.read_bytes())[0]
    assert files_of(done.home.path) >= {"ca.key", "intermediate.pem", "intermediate.csr", "ca.db"}
    assert (done.home.path / "ca.key").stat().st_mode & 0o777 == 0o600
