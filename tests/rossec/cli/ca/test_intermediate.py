import time
from pathlib import Path

import pytest

from ca.errors import CertificateRefused
from rossec.authority.home import AuthorityHome
from rossec.home import NodeHome
from tests.support.commands import PASSPHRASE, Shell, refused

NOBODY = ("--master", "http://127.0.0.1:1")


@pytest.fixture
def host(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Shell:
    """The machine of the intermediate."""
    return Shell(tmp_path / "host", capsys)


def installed(shell: Shell, host: Shell, may: str = "enroll") -> str:
    assert host.unlocked("ca", "intermediate", "request", "home").code == 0
    request = host.root / "ca" / "intermediate.csr"
    carried = shell.root / "host.csr"
    carried.write_bytes(request.read_bytes())
    said = shell.unlocked("ca", "intermediate", "sign", str(carried), "--may", may, "--yes")
    assert said.code == 0, said
    taken = host.unlocked("ca", "intermediate", "install", str(shell.root / "host.pem"))
    assert taken.code == 0, taken
    powers = {"renew": "may renew until", "enroll": "may renew and enroll until"}
    assert powers[may] in taken.out
    return said.out.splitlines()[-1].split()[-1]


def test_a_host_enrolls_below_the_root(shell: Shell, host: Shell) -> None:
    name = installed(shell, host)
    host.enroll("/robot")
    home = NodeHome.of(host.root, "/robot")
    identity = home.identity(int(time.time()))
    assert len(identity.issuers) == 1
    assert home.anchor() == AuthorityHome.at(shell.root).anchor()
    assert f"{name}  until" in shell("ca", "list").out
    said = shell.unlocked("ca", "revoke", name, *NOBODY)
    assert said.out.startswith(f"revoked {name}, 1 key")
    revoked = AuthorityHome.at(shell.root).store().revoked_entries()
    assert identity.issuers[0] in revoked
    assert host("ca", "log", "verify").code == 0
    assert '"intermediate": true' in host("ca", "show", "--json").out


def test_a_host_signs_no_lists_and_comes_back_from_a_backup(
    shell: Shell, host: Shell, tmp_path: Path
) -> None:
    installed(shell, host)
    refused(host("ca", "publish", *NOBODY), "no revocation list was signed yet")
    refused(host.unlocked("ca", "refresh", *NOBODY), "an intermediate cannot revoke")
    backup = str(tmp_path / "backup")
    assert host.unlocked("ca", "backup", backup).code == 0
    restored = host.unlocked("ca", "restore", backup, "--over", "home")
    assert restored.code == 0
    assert "revo" not in restored.err
    assert AuthorityHome.at(host.root).is_intermediate


def test_a_host_that_may_only_renew(shell: Shell, host: Shell) -> None:
    installed(shell, host, "renew")
    host("node", "request", "/robot")
    request = str(host.node("/robot") / "node.csr")
    refused(host.unlocked("ca", "sign", request, "--yes"), "may renew identities, not enroll")


def test_signing_shows_what_the_intermediate_may_do(shell: Shell, host: Shell) -> None:
    asked = host.unlocked("ca", "intermediate", "request", "home").out
    request = host.root / "ca" / "intermediate.csr"
    sign = ("ca", "intermediate", "sign", str(request), "--yes")
    refused(shell.unlocked(*sign), "missing option '--may'. Choose from: renew, enroll", code=2)
    said = shell.unlocked(*sign, "--may", "renew").out
    assert said.startswith("an intermediate of home that may renew identities until 20")
    assert asked.splitlines()[1].strip() == said.splitlines()[1].strip()
    assert request.with_suffix(".pem").exists()


def test_a_pending_request_is_not_overwritten(shell: Shell, host: Shell) -> None:
    request = ("ca", "intermediate", "request", "home")
    refused(shell.unlocked(*request), "there is an authority in", "on another host, there: ROSSEC_HOME=")
    assert host.unlocked(*request).code == 0
    refused(host("ca", "list"), "there is no authority")
    refused(host.unlocked(*request), "exists and is not overwritten")


def test_only_a_matching_bundle_is_installed(
    shell: Shell, host: Shell, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    installed(shell, host)
    install = ("ca", "intermediate", "install")
    refused(host.unlocked(*install, str(shell.root / "ca" / "ca.pem")), "a bundle of 1 certificates")
    other = Shell(tmp_path / "other", capsys)
    assert other.unlocked("ca", "init", "home").code == 0
    strange = other.root / "host.csr"
    strange.write_bytes((shell.root / "host.csr").read_bytes())
    sign = ("ca", "intermediate", "sign", str(strange), "--may", "renew", "--yes")
    assert other.unlocked(*sign).code == 0
    refused(host.unlocked(*install, str(other.root / "host.pem")), "of another root", "start again")
    again = host.unlocked(*install, str(shell.root / "host.pem"))
    assert again.code == 0
    home = AuthorityHome.at(host.root)
    assert home.unlock(PASSPHRASE).authority.may_enroll
    with pytest.raises(CertificateRefused):
        home.anchor().read_intermediate(home.anchor().certificate)


def test_a_host_signs_no_grants(shell: Shell, host: Shell) -> None:
    installed(shell, host)
    host.enroll("/robot")
    said = host.unlocked("grant", "sign", "/robot", "--subscribe", "/a", "--for", "1d")
    refused(said, "an intermediate cannot sign grants", "do it at the root")
    assert AuthorityHome.at(host.root).store().grants() == []


def test_the_root_says_what_its_record_does_not_know(shell: Shell, host: Shell) -> None:
    """A name may have been certified for another key below an intermediate."""
    shell.enroll("/doctor")
    assert "may have certified" not in shell.unlocked("ca", "revoke", "/doctor", *NOBODY).err
    shell.enroll("/nurse")
    name = installed(shell, host)
    said = shell.unlocked("ca", "revoke", "/nurse", *NOBODY)
    assert f"{name} may have certified other keys for /nurse" in said.err
    assert "rossec ca import" in said.err
    said = host("ca", "invite", "/fleet/*", "--address", "127.0.0.1:9")
    assert "each waits for a person" in said.err
