"""What a restore could do to the revoked, to opt-outs and to invitations, and a crash in it."""

import os
import signal
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from ca.errors import CAError
from ca.revocation.trust_status import Revocations
from ca.store.values import RequestState
from ca.svid import check_request
from rossec import files
from rossec.authority.backup import back_up, restore
from rossec.authority.home import AuthorityHome
from rossec.authority.invitations import invitations, invite
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from tests.support.commands import PASSPHRASE, Shell, refused
from tests.support.joining import asked

NOW = int(time.time())
NOBODY = ("--master", "http://127.0.0.1:1")
DAY = 86400

pytestmark = pytest.mark.attack("old-backup")


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ca.keys.passphrases._N", 16)  # the passphrase is not under test
    monkeypatch.setattr("ca.keys.passphrases._N", 16)


@pytest.fixture
def site(quick: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Shell:
    shell = Shell(tmp_path / "site", capsys)
    assert shell.unlocked("ca", "init", "home").code == 0
    return shell


def backed_up(site: Shell) -> str:
    file = str(site.root / "given.backup")
    assert site.unlocked("ca", "backup", file).code == 0
    return file


def entries(home: Path) -> frozenset[bytes]:
    with closing(AuthorityHome.at(home).store()) as store:
        return store.revoked_entries()


def test_a_restore_says_what_it_would_bring_back_before_it_does_anything(site: Shell) -> None:
    site.enroll("/robot")
    file = backed_up(site)
    site.unlocked("ca", "revoke", "/robot", *NOBODY)
    newest = site.root / "revocations.cose"  # as every node has it
    newest.write_bytes(AuthorityHome.at(site.root).revocation_list())
    (site.root / "ca").rename(site.root / "lost")
    before = sorted(site.root.rglob("*"))
    refused(site.unlocked("ca", "restore", file), "revoked after the backup", "revocations.cose")
    assert sorted(site.root.rglob("*")) == before
    both = site.unlocked("ca", "restore", file, "--list", str(newest), "--without-list")
    refused(both, "exclude each other", code=2)
    assert site.unlocked("ca", "restore", file, "--list", str(newest)).code == 0
    assert len(entries(site.root)) == 1


def test_a_list_that_is_found_later_is_taken_over(site: Shell) -> None:
    site.enroll("/robot")
    file = backed_up(site)
    site.unlocked("ca", "revoke", "/robot", *NOBODY)
    newest = site.root / "revocations.cose"
    newest.write_bytes(AuthorityHome.at(site.root).revocation_list())
    (site.root / "ca").rename(site.root / "lost")
    said = site.unlocked("ca", "restore", file, "--without-list")
    assert "rossec ca refresh --list FILE" in said.err
    assert entries(site.root) == frozenset()
    site.enroll("/lamp")  # what was done since is not lost
    said = site.unlocked("ca", "refresh", "--list", str(newest), *NOBODY)
    assert "1 revocations were taken over" in said.out
    assert len(entries(site.root)) == 1
    assert "/lamp" in site("ca", "list").out
    assert site("ca", "log", "verify").code == 0
    again = site.unlocked("ca", "restore", file, "--over", "home", "--list", str(newest))
    lost = again.err.partition("--forget ")[2].split()[0]
    over = ("--over", "home", "--forget", lost, "--list", str(newest))
    assert site.unlocked("ca", "restore", file, *over).code == 0
    assert len(entries(site.root)) == 1


def test_a_list_from_before_the_backup_does_not_pass_for_a_newer_one(site: Shell) -> None:
    """Of a node that was off for long: it says nothing of what the backup lacks."""
    site.enroll("/robot")
    stale = site.root / "revocations.cose"
    stale.write_bytes(AuthorityHome.at(site.root).revocation_list())
    assert site.unlocked("ca", "refresh", *NOBODY).code == 3
    file = backed_up(site)
    site.unlocked("ca", "revoke", "/robot", *NOBODY)
    (site.root / "ca").rename(site.root / "lost")
    before = sorted(site.root.rglob("*"))
    said = site.unlocked("ca", "restore", file, "--list", str(stale))
    refused(said, "older than the backup", "the master has the newest")
    assert sorted(site.root.rglob("*")) == before


def test_the_hint_names_a_list_that_is_here_and_it_works(site: Shell) -> None:
    site.enroll("/robot")
    site.enroll("/master")
    file = backed_up(site)
    site.unlocked("ca", "revoke", "/robot", *NOBODY)
    NodeHome.of(site.root, "/master").save_revocations(AuthorityHome.at(site.root).revocation_list())
    (site.root / "ca").rename(site.root / "lost")
    hint = site.unlocked("ca", "restore", file).err.splitlines()[1]
    named = hint.partition("--list ")[2].partition(";")[0]
    assert Path(named).parent.name == "master"
    done = site.unlocked("ca", "restore", file, "--list", named)
    assert "1 revocations newer than the backup were taken over" in done.out


def test_a_restore_that_is_repeated_says_how_to_go_on(site: Shell) -> None:
    site.enroll("/robot")
    file = backed_up(site)
    site.unlocked("ca", "revoke", "/robot", *NOBODY)
    newest = site.root / "revocations.cose"
    newest.write_bytes(AuthorityHome.at(site.root).revocation_list())
    (site.root / "ca").rename(site.root / "lost")
    assert site.unlocked("ca", "restore", file, "--without-list").code == 0
    listed = ("ca", "restore", file, "--list", str(newest))
    again = site.unlocked(*listed)
    refused(again, "there is an authority", "rossec ca refresh --list FILE")
    assert again.err.rstrip().endswith("--over home")
    bare = site.unlocked("ca", "restore", file).err
    assert bare.rstrip().endswith("--over home --list FILE"), "one hint says all that is missing"
    again = site.unlocked(*listed, "--over", "home")
    refused(again, "lacks", "it was restored here before; only to revoke")
    lost = again.err.partition("--forget ")[2].split()[0]
    assert site.unlocked(*listed, "--over", "home", "--forget", lost).code == 0
    assert len(entries(site.root)) == 1
    assert site("ca", "log", "verify").code == 0


def test_another_authority_is_not_replaced_by_its_namesake(
    site: Shell, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not even by name: the hint does not lead there."""
    other = Shell(tmp_path / "other", capsys)
    assert other.unlocked("ca", "init", "home").code == 0
    said = other.unlocked("ca", "restore", backed_up(site), "--without-list")
    refused(said, "is not the one in the backup", "another ROSSEC_HOME")


def test_what_the_replaced_authority_revoked_stays_revoked(site: Shell) -> None:
    site.enroll("/robot")
    file = backed_up(site)
    site.unlocked("ca", "revoke", "/robot", *NOBODY)
    held = entries(site.root)
    over = ("ca", "restore", file, "--over", "home", "--without-list")
    lost = site.unlocked(*over).err.partition("--forget ")[2].split()[0]
    assert site.unlocked(*over, "--forget", lost).code == 0
    assert entries(site.root) == held != frozenset()


POLICY = "rossec: 1\nrobot: r\nrules: []\n# {}\n"


@pytest.mark.parametrize("linked", [False, True])
def test_an_opt_out_is_not_undone(site: Shell, tmp_path: Path, linked: bool) -> None:
    policy, mine = site.root / "ca" / "policy.yaml", tmp_path / "mine.yaml"
    policy.write_text(POLICY.format("everybody sees"))
    policy.chmod(0o600)
    file = backed_up(site)
    mine.write_text(POLICY.format("opted out"))
    mine.chmod(0o600)
    policy.unlink()
    policy.symlink_to(mine) if linked else policy.write_bytes(mine.read_bytes())
    over = ("ca", "restore", file, "--over", "home", "--without-list")
    said = site.unlocked(*over)
    assert said.code == 0
    assert "the policy is that of the replaced authority" in said.err
    assert policy.read_bytes() == mine.read_bytes()
    assert policy.is_symlink() == linked
    lost = site.unlocked(*over).err.partition("--forget ")[2].split()[0]
    said = site.unlocked(*over, "--forget", lost, "--policy", "backup")
    assert "the policy is that of the backup" in said.err
    assert policy.read_text() == POLICY.format("everybody sees")


def test_an_older_list_of_the_own_node_does_not_come_back(site: Shell) -> None:
    node = AuthorityHome.at(site.root).node()
    node.save_revocations(AuthorityHome.at(site.root).revocation_list())
    file = backed_up(site)
    site.enroll("/robot")
    site.unlocked("ca", "revoke", "/robot", *NOBODY)
    newest = AuthorityHome.at(site.root).revocation_list()
    node.save_revocations(newest)
    over = ("ca", "restore", file, "--over", "home", "--without-list")
    lost = site.unlocked(*over).err.partition("--forget ")[2].split()[0]
    assert site.unlocked(*over, "--forget", lost).code == 0
    assert node.load_revocations() == newest


def test_a_clock_that_is_ahead_leaves_no_invitation_open(site: Shell, tmp_path: Path) -> None:
    home = AuthorityHome.at(site.root)
    invite(home, "/fleet/*", 5, NOW + DAY, "127.0.0.1:9", NOW)
    with closing(home.store()) as store:
        csr = asked("/robot")
        store.requests.add(check_request(csr, "home"), csr, "test", NOW)
        approved = store.requests.approve(check_request(csr, "home").digest, NOW)
    data = back_up(home, PASSPHRASE)
    restored = restore(tmp_path / "new", data, PASSPHRASE, NOW + 10 * DAY).home
    with closing(restored.store()) as store:
        (found,) = invitations(store)
        assert found.state(NOW) == "ended: restored from a backup"
        # It may have been denied since.
        assert store.requests.get(approved.digest).state is RequestState.DENIED
        store.log.audit(restored.own_key())


def test_after_a_restore_with_the_clock_ahead_lists_are_still_newer(site: Shell) -> None:
    home = AuthorityHome.at(site.root)
    data, later = back_up(home, PASSPHRASE), NOW + 1000 * DAY
    ahead = restore(site.root, data, PASSPHRASE, later, over="home").home
    nodes = Revocations(home.own_key())
    nodes.update(ahead.revocation_list(), later)
    with pytest.raises(CAError, match="lacks") as caught:
        restore(site.root, data, PASSPHRASE, NOW, over="home")
    lost = int(caught.value.hint.rpartition(" ")[2])
    again = restore(site.root, data, PASSPHRASE, NOW, over="home", forget=lost).home
    again.unlock(PASSPHRASE).revoke(b"k" * 32, "stolen", NOW)
    nodes.update(again.revocation_list(), NOW)
    assert b"k" * 32 in nodes.entries


def _killed(act: Callable[[], object]) -> int:
    """Run `act` in a process of its own; returns the signal that ended it."""
    child = os.fork()
    if child == 0:
        try:
            act()
        finally:
            os._exit(0)
    return os.WTERMSIG(os.waitpid(child, 0)[1])


def _killing(function: Callable[..., object], *, before: bool) -> Callable[..., object]:
    def killed(*arguments: object) -> None:
        if not before:
            function(*arguments)
        os.kill(os.getpid(), signal.SIGKILL)

    return killed


@pytest.mark.parametrize("before", [True, False])
@pytest.mark.parametrize("step", ["exchange", "rename"])
def test_a_kill_at_any_step_leaves_an_authority(
    site: Shell, monkeypatch: pytest.MonkeyPatch, step: str, before: bool
) -> None:
    home = AuthorityHome.at(site.root)
    data = back_up(home, PASSPHRASE)
    module = files if step == "exchange" else Path
    with monkeypatch.context() as patched:
        patched.setattr(module, step, _killing(getattr(module, step), before=before))
        if step == "rename":  # the one to where the authority that is replaced will be
            patched.setattr(files, "replace", lambda *_: None)
        ended = _killed(lambda: restore(site.root, data, PASSPHRASE, NOW, over="home"))
    assert ended == signal.SIGKILL
    unlocked = AuthorityHome.at(site.root).unlock(PASSPHRASE)
    unlocked.store.log.audit(unlocked.signer.public_key)
    is_restored = [entry.what for entry in unlocked.store.log.entries()].count("restored") == 1
    assert is_restored == (step == "exchange" and not before)
    unlocked.store.close()
    held = [each for each in site.root.glob("*ca*") if (each / "ca.key").exists()]
    held += site.root.glob(".ca.*")
    if is_restored:
        assert [*site.root.glob(".ca.*")] == [], "the replaced authority is where it is said to be"
    assert len(set(held)) == 2, "neither the new nor the old authority is lost"
    assert site("ca", "show").code == 0


def test_an_interruption_after_the_exchange_keeps_both(site: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    home = AuthorityHome.at(site.root)
    data, exchange = back_up(home, PASSPHRASE), files.exchange

    def interrupted(one: Path, other: Path) -> None:
        exchange(one, other)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(files, "exchange", interrupted)
        with pytest.raises(KeyboardInterrupt):
            restore(site.root, data, PASSPHRASE, NOW, over="home")
    assert [*site.root.glob(".ca.*")] == []
    (aside,) = site.root.glob("ca.replaced.*")
    for each in (AuthorityHome(aside), AuthorityHome.at(site.root)):
        unlocked = each.unlock(PASSPHRASE)
        unlocked.store.log.audit(unlocked.signer.public_key)


def test_an_exchange_that_fails_leaves_all_as_it_was(site: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    data, before = back_up(AuthorityHome.at(site.root), PASSPHRASE), {*site.root.rglob("*")}

    def refuses(*_: object) -> None:
        raise ConfigurationError("this file system cannot")

    with monkeypatch.context() as patched:
        patched.setattr(files, "exchange", refuses)
        with pytest.raises(ConfigurationError, match="cannot"):
            restore(site.root, data, PASSPHRASE, NOW, over="home")
    assert {*site.root.rglob("*")} - before <= {site.root / "ca" / "service.lock"}
