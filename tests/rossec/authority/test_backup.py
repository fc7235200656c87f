import shutil
import sqlite3
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from ca.errors import (
    ApprovalRefused,
    CAError,
    LogDamaged,
    PassphraseRefused,
    RecordUnusable,
    RevocationRefused,
    StoreError,
)
from ca.revocation.lists import TreeEntries, is_tree, open_list
from rossec import files
from rossec.authority import backup as backups
from rossec.authority.backup import back_up, restore
from rossec.authority.home import AuthorityHome
from rossec.authority.invitations import invite
from rossec.authority.keyservice.client import LOCK, service_lock
from rossec.errors import ConfigurationError
from tests.support import approving, passkeys, refusal_texts
from tests.support.commands import PASSPHRASE, Shell, refused

NOW = int(time.time())
NOBODY = ("--master", "http://127.0.0.1:1")


@pytest.fixture
def home(tmp_path: Path, authority: Path) -> AuthorityHome:
    """An authority with some extra files."""
    place = tmp_path / "home" / "ca"
    shutil.copytree(authority, place)
    (place / "inbox").mkdir()
    (place / "inbox" / "1.request").write_bytes(b"asked")
    (place / "policy.yaml").write_bytes(b"rules: []\n")
    return AuthorityHome(place)


def content(home: AuthorityHome) -> dict[str, bytes]:
    return {
        str(path.relative_to(home.path)): path.read_bytes()
        for path in home.path.rglob("*")
        if path.is_file() and not path.name.startswith("ca.db") and path.name != LOCK
    }


def revoked(home: AuthorityHome) -> frozenset[bytes]:
    return open_list(home.revocation_list(), home.own_key()).entries


def test_everything_comes_back(home: AuthorityHome, tmp_path: Path) -> None:
    done = restore(tmp_path / "new", back_up(home, PASSPHRASE), PASSPHRASE, NOW)
    assert done.home.path == tmp_path / "new" / "ca"
    assert content(done.home) == content(home)
    assert done.home.anchor() == home.anchor()
    for path in done.home.path.rglob("*"):
        public = path.is_dir() or path.name.endswith(".pem")
        assert path.stat().st_mode & 0o077 == 0 or public, path
    unlocked = done.home.unlock(PASSPHRASE)
    unlocked.store.log.audit(unlocked.signer.public_key)
    assert [entry.what for entry in unlocked.store.log.entries()[-2:]] == ["restored", "list"]


def test_a_restore_ends_passkeys_and_what_waits(home: AuthorityHome, tmp_path: Path) -> None:
    """The backup does not know which phone was removed since, nor what was carried out."""
    device = passkeys.Passkey()
    with closing(home.store()) as store:
        store.passkeys.add(approving.registered(device, at=NOW))
        waits, late = (approving.approve(store, id=id_ * 16, device=device, at=NOW) for id_ in (b"1", b"2"))
        store.approvals.add(waits)
        data = back_up(home, PASSPHRASE)
        store.approvals.add(late)
        store.passkeys.end(device.id, "stolen", NOW)
    restored = restore(tmp_path / "new", data, PASSPHRASE, NOW).home
    with closing(restored.store()) as store:
        assert store.passkeys.active() == []
        assert store.passkeys.ended() == {device.id: "restored from a backup"}
        assert store.approvals.waiting() == []
        assert store.approvals.ends()[waits.id].state == "failed"
        with pytest.raises(ApprovalRefused, match=refusal_texts.PASSKEY_UNKNOWN):
            store.approvals.add(late)
        store.passkeys.add(approving.registered(passkeys.Passkey(), "again", NOW))
        store.log.audit(restored.own_key())


def test_a_new_epoch_beats_what_was_signed_since(home: AuthorityHome, tmp_path: Path) -> None:
    data = back_up(home, PASSPHRASE)
    before = home.unlock(PASSPHRASE).sign_list(NOW)
    restored = restore(tmp_path / "new", data, PASSPHRASE, NOW).home
    after = open_list(restored.revocation_list(), home.own_key())
    assert after.number == (NOW, 1)
    assert after.number > before.number
    again = restore(tmp_path / "other", data, PASSPHRASE, NOW + 1).home
    assert open_list(again.revocation_list(), home.own_key()).number > after.number


def test_revocations_since_then_come_back_from_a_list(home: AuthorityHome, tmp_path: Path) -> None:
    data = back_up(home, PASSPHRASE)
    home.unlock(PASSPHRASE).revoke(b"k" * 32, "stolen", NOW)
    newest = home.revocation_list()
    assert revoked(restore(tmp_path / "a", data, PASSPHRASE, NOW).home) == frozenset()
    done = restore(tmp_path / "b", data, PASSPHRASE, NOW, newest_list=newest)
    assert done.restored_revocations == 1
    assert revoked(done.home) == {b"k" * 32}


def test_revocations_come_back_from_a_tree_with_its_entries(
    home: AuthorityHome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = back_up(home, PASSPHRASE)
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    home.unlock(PASSPHRASE).revoke(b"k" * 32, "stolen", NOW)
    tree, entries = home.revocation_list(), home.newest_statement()[1]
    assert is_tree(tree)
    with pytest.raises(CAError, match="a tree, which does not contain") as caught:
        restore(tmp_path / "a", data, PASSPHRASE, NOW, newest_list=tree)
    assert "--entries" in caught.value.hint
    for wrong in (TreeEntries([b"x" * 32]).encoded(), b"garbage"):
        with pytest.raises(RevocationRefused):
            restore(tmp_path / "a", data, PASSPHRASE, NOW, newest_list=tree, entries=wrong)
    assert not list((tmp_path / "a").iterdir())
    done = restore(tmp_path / "b", data, PASSPHRASE, NOW, newest_list=tree, entries=entries)
    assert done.restored_revocations == 1
    with closing(done.home.store()) as store:
        assert store.revoked_entries() == {b"k" * 32}
    assert TreeEntries.read(done.home.newest_statement()[1]).entries == {b"k" * 32}


def test_a_wrong_passphrase(home: AuthorityHome, tmp_path: Path) -> None:
    data = back_up(home, PASSPHRASE)
    with pytest.raises(PassphraseRefused):
        restore(tmp_path / "new", data, "another four words", NOW)
    with pytest.raises(PassphraseRefused):  # opens the backup, not the key in it
        restore(tmp_path / "new", data, PASSPHRASE, NOW, secret="another four words")
    assert not list((tmp_path / "new").glob("*"))
    assert not list((tmp_path / "new").glob(".ca*"))


def test_a_backup_of_a_changed_record_is_refused(home: AuthorityHome, tmp_path: Path) -> None:
    with closing(sqlite3.connect(home.path / "ca.db")) as db:
        db.execute("DROP TRIGGER log_no_UPDATE")
        db.execute("UPDATE log SET detail = 'x' WHERE number = 0")
        db.commit()
    with pytest.raises(LogDamaged, match="log entry 0"):
        restore(tmp_path / "new", back_up(home, PASSPHRASE), PASSPHRASE, NOW)
    assert not (tmp_path / "new" / "ca").exists()


def test_nothing_is_overwritten_unless_it_is_said(home: AuthorityHome) -> None:
    data, root = back_up(home, PASSPHRASE), home.path.parent
    before = content(home)
    for over in (None, "lab"):
        with pytest.raises(CAError, match="there is an authority in") as caught:
            restore(root, data, PASSPHRASE, NOW, over=over)
        assert "--over home" in caught.value.hint
    assert content(home) == before
    restore(root, data, PASSPHRASE, NOW, over="home")
    assert (root / f"ca.replaced.{NOW}" / "ca.key").read_bytes() == before["ca.key"]
    restore(root, data, PASSPHRASE, NOW, over="home", forget=2)  # in the same second
    assert (root / f"ca.replaced.{NOW + 1}").exists()


def test_an_older_state_is_refused_unless_it_is_said(home: AuthorityHome) -> None:
    data, root = back_up(home, PASSPHRASE), home.path.parent
    home.unlock(PASSPHRASE).revoke(b"k" * 32, "stolen", NOW)
    with pytest.raises(CAError, match="the backup lacks 2 entries of the log") as caught:
        restore(root, data, PASSPHRASE, NOW, over="home")
    assert "--forget 2" in caught.value.hint
    with pytest.raises(CAError, match="lacks 2 entries"):
        restore(root, data, PASSPHRASE, NOW, over="home", forget=1)
    assert revoked(home) == {b"k" * 32}
    restore(root, data, PASSPHRASE, NOW, over="home", forget=2)
    assert revoked(home) == {b"k" * 32}, "what was revoked here stays revoked"


def test_another_authority_is_never_replaced(home: AuthorityHome, tmp_path: Path) -> None:
    other = AuthorityHome.create(tmp_path / "other", "home", PASSPHRASE, NOW)
    data = back_up(other, PASSPHRASE)
    with pytest.raises(CAError, match="is not the one in the backup"):
        restore(home.path.parent, data, PASSPHRASE, NOW, over="home")


def test_an_interrupted_restoration_changes_nothing(
    home: AuthorityHome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    data = back_up(home, PASSPHRASE)
    monkeypatch.setattr(files, "commit_directory", interrupted)
    with pytest.raises(KeyboardInterrupt):
        restore(tmp_path / "new", data, PASSPHRASE, NOW)
    assert not list((tmp_path / "new").iterdir())


def test_the_command_line_backs_up_and_restores(shell: Shell, tmp_path: Path) -> None:
    target = str(tmp_path / "backup")
    said = shell.unlocked("ca", "backup", target)
    assert said.out.startswith(f"backup of home: {target}\nfingerprint ")
    refused(shell.unlocked("ca", "backup", target), "exists and is not overwritten")
    assert Path(target).stat().st_mode & 0o777 == 0o600
    refused(shell.unlocked("ca", "restore", target), "there is an authority", "--over home")
    shell.unlocked("ca", "revoke", "/ca", *NOBODY)
    shell.enroll("/robot")
    refused(shell.unlocked("ca", "restore", target, "--over", "home"), "lacks 4", "--forget 4")
    newest = shell.root / "newest"
    shell.unlocked("ca", "revoke", "/robot", *NOBODY)
    newest.write_bytes(AuthorityHome.at(shell.root).revocation_list())
    over = ("ca", "restore", target, "--over", "home", "--forget", "6")
    done = shell.unlocked(*over, "--list", str(newest))
    assert "1 revocations newer than the backup were taken over" in done.out
    assert "was revoked after the backup" not in done.err
    again = shell.unlocked("ca", "restore", target, "--over", "home", "--forget", "3", "--without-list")
    assert "what was revoked after the backup is valid again" in again.err
    newest.write_bytes(AuthorityHome.at(shell.root).revocation_list())
    empty = shell.unlocked("ca", "restore", target, "--over", "home", "--forget", "3", "--list", str(newest))
    assert empty.code == 0
    assert "1 revocations newer than the backup were taken over" in empty.out
    assert shell("ca", "log", "verify").code == 0


def test_a_home_below_a_directory_called_grants(authority: Path, tmp_path: Path) -> None:
    home = AuthorityHome(tmp_path / "grants" / "ca")
    shutil.copytree(authority, home.path)
    done = restore(tmp_path / "new", back_up(home, PASSPHRASE), PASSPHRASE, NOW)
    assert content(done.home) == content(home)


@pytest.mark.parametrize("lost", ["ca.db", "ca.pem"])
def test_what_is_damaged_is_moved_away_by_hand(home: AuthorityHome, lost: str) -> None:
    data = back_up(home, PASSPHRASE)
    (home.path / lost).unlink()
    with pytest.raises(CAError, match="is incomplete") as caught:
        restore(home.path.parent, data, PASSPHRASE, NOW, over="home")
    assert "move that directory away" in caught.value.hint
    home.path.rename(home.path.with_name("damaged"))
    assert restore(home.path.parent, data, PASSPHRASE, NOW).home.domain == "home"


def test_the_entries_beside_a_tree_are_found(
    shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = str(tmp_path / "backup")
    shell.unlocked("ca", "backup", target)
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    shell.enroll("/robot")
    shell.unlocked("ca", "revoke", "/robot", *NOBODY)
    home, kept = AuthorityHome.at(shell.root), tmp_path / "master"
    kept.mkdir()
    (kept / "revocations.cose").write_bytes(home.revocation_list())
    plain = ("ca", "restore", target, "--over", "home")
    forget = shell.unlocked(*plain).err.partition("--forget ")[2].split()[0]
    over = (*plain, "--forget", forget, "--list", str(kept / "revocations.cose"))
    refused(shell.unlocked(*over), "a tree", "--entries")
    (kept / "other").write_bytes(home.newest_statement()[1])
    refused(shell.unlocked(*over, "--entries", str(shell.secret)), "not the entries of a revocation tree")
    (kept / "other").rename(kept / "revocations.entries")
    done = shell.unlocked(*over)
    assert "1 revocations newer than the backup" in done.out


def test_no_revocation_goes_into_a_record_that_is_being_replaced(
    home: AuthorityHome, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the comparison with the backup until it has moved, and not into what was moved."""
    data, other = back_up(home, PASSPHRASE), home.unlock(PASSPHRASE)
    other.store.database.connection.execute("PRAGMA busy_timeout = 0")
    check, refused = backups._check_replacement, list[str]()

    def meanwhile(*arguments: Any) -> None:
        check(*arguments)
        with pytest.raises(RecordUnusable) as caught:
            other.revoke(b"k" * 32, "meanwhile", NOW)
        refused.append(str(caught.value))

    monkeypatch.setattr(backups, "_check_replacement", meanwhile)
    restore(home.path.parent, data, PASSPHRASE, NOW, over="home")
    assert "another command is using it" in refused[0]
    with pytest.raises(StoreError, match="was replaced by another command"):
        other.revoke(b"k" * 32, "afterwards", NOW)
    assert b"k" * 32 in home.unlock(PASSPHRASE).revoke(b"k" * 32, "again", NOW).entries


def test_a_running_service_keeps_its_authority(home: AuthorityHome) -> None:
    data = back_up(home, PASSPHRASE)
    with service_lock(home.path):
        with pytest.raises(ConfigurationError, match="service runs") as caught:
            restore(home.path.parent, data, PASSPHRASE, NOW, over="home")
        assert "end it first" in caught.value.hint
    restore(home.path.parent, data, PASSPHRASE, NOW, over="home")


def test_the_audit_of_the_service_is_not_in_a_backup(home: AuthorityHome, tmp_path: Path) -> None:
    for name in ("audit.log", "audit.log.1"):
        (home.path / name).write_text("a line")
    with service_lock(home.path):
        data = back_up(home, PASSPHRASE)
    restored = restore(tmp_path / "elsewhere", data, PASSPHRASE, NOW).home
    assert not {"audit.log", "audit.log.1", "service.lock"} & {path.name for path in restored.path.iterdir()}


def test_invitations_end(home: AuthorityHome, tmp_path: Path) -> None:
    """The backup does not know which of their uses were taken since."""
    code = invite(home, "/fleet/*", 3, NOW + 3600, "127.0.0.1:9", NOW)
    done = restore(tmp_path / "new", back_up(home, PASSPHRASE), PASSPHRASE, NOW)
    with closing(done.home.store()) as store:
        assert store.invitations.ended(code.id) == "restored from a backup"
