"""The authority on the master's host: its lists are seen, and only when there may be changed."""

from pathlib import Path

import pytest

from ca.domains import open_domains
from ca.revocation.lists import TreeEntries, is_tree, open_list, open_tree
from rossec.authority.home import AuthorityHome
from rossec.authority.local_list import LocalList
from rossec.errors import NotWritten
from tests.support.commands import Shell


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Shell:
    shell = Shell(tmp_path / "home", capsys)
    assert shell.unlocked("ca", "init", "home").code == 0
    return shell


def test_without_an_authority_there_is_no_list(tmp_path: Path) -> None:
    local_list = LocalList(tmp_path)
    assert local_list.newest() is None
    assert local_list.newest_if_changed() is None
    assert local_list.domains() == local_list.domains_if_changed() == b""


def test_a_new_list_of_domains_is_returned_once(shell: Shell) -> None:
    local_list = LocalList(shell.root)
    assert local_list.domains_if_changed() == b""
    shell.enroll("/master")
    assert local_list.domains_if_changed() == b""
    shell.enroll("/master/kitchen")
    found = local_list.domains_if_changed()
    assert len(open_domains(found, AuthorityHome.at(shell.root).anchor()).masters) == 2
    for _ in range(3):
        local_list.domains_if_changed()
    assert local_list.domains_if_changed() == b""
    assert local_list.domains() == found


def test_a_new_list_is_returned_once(shell: Shell) -> None:
    local_list, key = LocalList(shell.root), AuthorityHome.at(shell.root).anchor().public_key
    first = local_list.newest()
    assert first is not None
    assert first[1] == b""
    assert local_list.newest_if_changed() is None
    shell.unlocked("ca", "refresh")
    changed = local_list.newest_if_changed()
    assert changed is not None
    assert open_list(changed[0], key).seq == open_list(first[0], key).seq + 1
    for _ in range(3):
        local_list.newest_if_changed()
    assert local_list.newest_if_changed() is None


def test_a_tree_comes_with_its_entries(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    local_list, key = LocalList(shell.root), AuthorityHome.at(shell.root).anchor().public_key
    shell.enroll("/robot")
    shell.unlocked("ca", "revoke", "/robot")
    found = local_list.newest_if_changed()
    assert found is not None
    assert is_tree(found[0])
    TreeEntries.read(found[1]).check(open_tree(found[0], key))


def test_what_could_not_be_read_is_read_again(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else who fills the disk for a moment keeps a revocation from the master for good."""
    local_list = LocalList(shell.root)
    local_list.newest()
    shell.unlocked("ca", "refresh")

    def fail(_: AuthorityHome) -> bytes:
        raise NotWritten("no room on the disk", "make room")

    with monkeypatch.context() as full:
        full.setattr(AuthorityHome, "revocation_list", fail)
        for _ in range(2):
            with pytest.raises(NotWritten):
                local_list.newest_if_changed()
    assert local_list.newest_if_changed() is not None
