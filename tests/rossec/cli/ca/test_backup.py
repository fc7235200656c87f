from pathlib import Path

import pytest

from ca.revocation.lists import is_tree
from rossec.authority.backup import Restored
from rossec.authority.home import AuthorityHome
from rossec.cli.ca.home import say_what_differs
from tests.support.commands import Shell, refused


def test_a_restored_authority_is_the_one_of_the_backup(shell: Shell, tmp_path: Path) -> None:
    target = str(tmp_path / "backup")
    said = shell.unlocked("ca", "backup", target)
    assert said.out.startswith(f"backup of home: {target}\nfingerprint ")
    fingerprint = said.out.splitlines()[1]
    (shell.root / "ca").rename(shell.root / "aside")
    done = shell.unlocked("ca", "restore", target, "--without-list")
    assert done.out.startswith(f"restored home in {shell.root / 'ca'}, ")
    assert fingerprint in done.out.splitlines()
    assert "what was revoked after the backup is valid again" in done.err
    assert "joined after the backup are not in the record: rossec ca import NODE.pem" in done.err
    assert fingerprint in shell("ca", "show").out.splitlines()


def test_an_authority_is_replaced_only_by_name(shell: Shell, tmp_path: Path) -> None:
    target = str(tmp_path / "backup")
    assert shell.unlocked("ca", "backup", target).code == 0
    refused(shell.unlocked("ca", "backup", target), "exists and is not overwritten")
    assert shell.unlocked("ca", "restore", target).code == 1
    assert shell.unlocked("ca", "restore", target, "--over", "other").code == 1
    assert shell.unlocked("ca", "restore", target, "--without-list", "--over", "home").code == 0


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


def test_a_list_that_adds_nothing_is_said(shell: Shell, tmp_path: Path) -> None:
    target, listed = tmp_path / "backup", tmp_path / "revocations.cose"
    shell.unlocked("ca", "backup", str(target))
    listed.write_bytes(AuthorityHome.at(shell.root).revocation_list())
    (shell.root / "ca").rename(shell.root / "aside")
    done = shell.unlocked("ca", "restore", str(target), "--list", str(listed))
    assert "nothing was revoked between the backup and the list" in done.out


def test_a_node_that_joined_after_the_backup_is_known_again(shell: Shell, tmp_path: Path) -> None:
    target = str(tmp_path / "backup")
    shell.unlocked("ca", "backup", target)
    shell.enroll("/late")
    (shell.root / "ca").rename(shell.root / "aside")
    assert shell.unlocked("ca", "restore", target, "--without-list").code == 0
    assert "/late" not in shell("ca", "list").out
    bundle = str(shell.node("/late") / "node.pem")
    assert shell.unlocked("ca", "import", "--yes", bundle).code == 0
    assert shell.unlocked("ca", "revoke", "/late", "--master", "http://127.0.0.1:1").code == 3
    assert len(AuthorityHome.at(shell.root).store().revoked_entries()) == 1


def test_what_is_no_file_of_an_authority_is_left_out_and_named(shell: Shell, tmp_path: Path) -> None:
    (shell.root / "ca" / "notes.txt").write_text("where the key is")
    said = shell.unlocked("ca", "backup", str(tmp_path / "backup"))
    assert "left out, as it is no file of an authority: notes.txt" in said.err


def test_the_two_words_about_the_list_exclude_each_other(shell: Shell, tmp_path: Path) -> None:
    given = ("--list", str(tmp_path / "x"), "--without-list")
    assert shell.unlocked("ca", "restore", str(tmp_path / "x"), *given).code == 2


def test_what_differs_after_a_restore_is_said(shell: Shell, capsys: pytest.CaptureFixture[str]) -> None:
    home = AuthorityHome.at(shell.root)
    say_what_differs(
        Restored(home, 3, 0, ended_domains=2, ended_phones=1, policy="of the backup", left_out=("notes.txt",))
    )
    said = capsys.readouterr().err
    for part in (
        "not a file that a backup has: notes.txt",
        "the policy is that of the backup",
        "no phone can approve",
        "2 domains are trusted no more",
    ):
        assert part in said
