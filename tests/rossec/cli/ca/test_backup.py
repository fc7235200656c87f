from pathlib import Path

from ca.revocation.tree import is_tree
from rossec.authority.home import AuthorityHome
from tests.support.commands import Shell, refused


def test_a_restored_authority_is_the_one_of_the_backup(shell: Shell, tmp_path: Path) -> None:
    target = str(tmp_path / "backup")
    said = shell.unlocked("ca", "backup", target)
    assert said.out.startswith(f"backup of home: {target}\nfingerprint ")
    fingerprint = said.out.splitlines()[1]
    (shell.root / "ca").rename(shell.root / "aside")
    done = shell.unlocked("ca", "restore", target)
    assert done.out.startswith(f"restored home in {shell.root / 'ca'}, ")
    assert fingerprint in done.out.splitlines()
    assert "what was revoked after the backup is valid again" in done.err
    assert fingerprint in shell("ca", "show").out.splitlines()


def test_an_authority_is_replaced_only_by_name(shell: Shell, tmp_path: Path) -> None:
    target = str(tmp_path / "backup")
    assert shell.unlocked("ca", "backup", target).code == 0
    refused(shell.unlocked("ca", "backup", target), "exists and is not overwritten")
    assert shell.unlocked("ca", "restore", target).code == 1
    assert shell.unlocked("ca", "restore", target, "--over", "other").code == 1
    assert shell.unlocked("ca", "restore", target, "--over", "home").code == 0


def test_a_file_that_is_no_backup_is_refused(shell: Shell, tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"nothing of the kind")
    assert shell.unlocked("ca", "restore", str(tmp_path / "x"), "--over", "home").code == 1


def test_what_was_revoked_since_comes_back_from_a_newer_list(shell: Shell, tmp_path: Path) -> None:
    shell.enroll("/robot")
    target, listed = tmp_path / "backup", tmp_path / "revocations.cose"
    shell.unlocked("ca", "backup", str(target))
    shell.unlocked("ca", "revoke", "/robot", "--master", "http://127.0.0.1:1")
    data = AuthorityHome.at(shell.root).revocation_list()
    assert not is_tree(data)
    listed.write_bytes(data)
    (tmp_path / "revocations.entries").write_bytes(b"of a tree")
    (shell.root / "ca").rename(shell.root / "aside")
    done = shell.unlocked("ca", "restore", str(target), "--list", str(listed))
    assert "1 revocations newer than the backup were taken over" in done.out
    assert "valid again" not in done.err
    assert len(AuthorityHome.at(shell.root).store().revoked_entries()) == 1
