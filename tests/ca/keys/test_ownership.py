"""Whom the places belong to that are believed. Other users are imagined, unless this is root."""

import grp
import os
import pwd
import stat
from pathlib import Path
from types import SimpleNamespace

import pytest

from ca.errors import PathRefused
from ca.keys import ownership


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    (tmp_path / "home").mkdir(mode=0o700)
    (tmp_path / "home" / "ca.pem").write_text("anchor")
    return tmp_path / "home"


def read(path: Path, *, link: bool = False) -> bytes:
    with os.fdopen(ownership.open_trusted(path, link=link), "rb") as file:
        return file.read()


def refused(path: Path, what: str, *, link: bool = False) -> str:
    with pytest.raises(PathRefused, match=what) as caught:
        read(path, link=link)
    return caught.value.hint


def as_another(monkeypatch: pytest.MonkeyPatch, number: int = 4242) -> None:
    """From now on what is here belongs to somebody else; the root directory stays root's."""
    real = os.stat_result

    def foreign(status: os.stat_result) -> os.stat_result:
        fields = list(status)
        fields[stat.ST_UID] = number
        return real(fields)

    lstat, fstat = os.lstat, os.fstat

    def look(path: Path) -> os.stat_result:
        return foreign(lstat(path)) if "home" in path.parts else lstat(path)

    monkeypatch.setattr(os, "lstat", look)
    monkeypatch.setattr(os, "fstat", lambda descriptor: foreign(fstat(descriptor)))


def test_ones_own_file_is_read(mine: Path) -> None:
    assert read(mine / "ca.pem") == b"anchor"
    (mine / "ca.pem").chmod(0o644)
    assert read(mine / "ca.pem") == b"anchor"
    with pytest.raises(FileNotFoundError):
        read(mine / "missing")


def test_a_directory_that_does_not_exist_is_not_asked(mine: Path) -> None:
    ownership.check_directory(mine / "nodes" / "robot")


@pytest.mark.parametrize("mode", [0o666, 0o602])
def test_a_file_others_can_write(mine: Path, mode: int) -> None:
    (mine / "ca.pem").chmod(mode)
    assert "chmod go-w" in refused(mine / "ca.pem", "ca.pem can be written by others")


@pytest.mark.parametrize("place", ["", "above"])
@pytest.mark.parametrize("mode", [0o777, 0o703])
def test_a_directory_others_can_write(mine: Path, place: str, mode: int) -> None:
    (mine.parent if place else mine).chmod(mode)
    refused(mine / "ca.pem", "can be written by others")


def test_a_sticky_directory_above_is_good_and_the_last_one_is_not(mine: Path) -> None:
    mine.parent.chmod(0o1777)
    assert read(mine / "ca.pem") == b"anchor"
    mine.chmod(0o1777)
    assert "chmod" not in refused(mine / "ca.pem", "home can be written by others")


@pytest.mark.parametrize("missing", [("new",), ("new", "nodes", "robot")])
def test_what_is_to_be_made_in_a_sticky_directory_is_good(mine: Path, missing: tuple[str, ...]) -> None:
    mine.chmod(0o1777)
    ownership.check_directory(mine.joinpath(*missing))
    mine.chmod(0o777)
    with pytest.raises(PathRefused, match="home can be written by others"):
        ownership.check_directory(mine.joinpath(*missing))


@pytest.mark.parametrize("target", [".", "./", "../home"])
def test_a_link_to_the_directory_it_is_in(mine: Path, target: str) -> None:
    (mine / "here").symlink_to(target)
    ownership.check_directory(mine / "here")
    mine.chmod(0o1777)
    with pytest.raises(PathRefused, match="home can be written by others"):
        ownership.check_directory(mine / "here")


def test_a_file_that_is_not_regular_is_refused(mine: Path) -> None:
    os.mkfifo(mine / "pipe")
    refused(mine / "pipe", "is not a regular file")
    refused(mine, "is not a regular file")


def test_a_link_is_followed_only_where_it_may_be(mine: Path) -> None:
    (mine / "link").symlink_to("ca.pem")
    assert "put the file itself there" in refused(mine / "link", "is a symbolic link")
    assert read(mine / "link", link=True) == b"anchor"
    (mine / "ca.pem").chmod(0o666)
    refused(mine / "link", "can be written by others", link=True)


def test_a_file_is_judged_without_opening_it(mine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As if it was opened."""
    (mine / "link").symlink_to("ca.pem")
    monkeypatch.setattr(os, "open", lambda path, flags: pytest.fail("opened"))
    ownership.check_trusted(mine / "ca.pem")
    with pytest.raises(FileNotFoundError):
        ownership.check_trusted(mine / "missing")
    with pytest.raises(PathRefused, match="is a symbolic link"):
        ownership.check_trusted(mine / "link")
    with pytest.raises(PathRefused, match="is not a regular file"):
        ownership.check_trusted(mine)
    (mine / "ca.pem").chmod(0o666)
    with pytest.raises(PathRefused, match="can be written by others"):
        ownership.check_trusted(mine / "ca.pem")
    mine.chmod(0o777)
    with pytest.raises(PathRefused, match="home can be written by others"):
        ownership.check_trusted(mine / "missing")


def test_every_link_on_the_way_is_followed(mine: Path) -> None:
    open_to_all = mine.parent / "open"
    (open_to_all / "deep").mkdir(parents=True)
    (mine / "up").symlink_to(open_to_all / "deep")
    (mine / "relative").symlink_to("../open/./deep")
    for link in ("up", "relative"):
        ownership.check_directory(mine / link)
    open_to_all.chmod(0o777)
    for link in ("up", "relative"):
        with pytest.raises(PathRefused, match="open can be written by others"):
            ownership.check_directory(mine / link)
    (mine / "round").symlink_to("round")
    with pytest.raises(PathRefused, match="too many symbolic links"):
        ownership.check_directory(mine / "round")


def test_a_directory_of_another_user_is_refused(mine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    as_another(monkeypatch)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    hint = refused(mine / "ca.pem", "home belongs to user 4242, who could change")
    assert "a ROSSEC_HOME of your own" in hint


def test_root_is_told_the_owner(mine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nobody = pwd.getpwnam("nobody")
    as_another(monkeypatch, nobody.pw_uid)
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    hint = refused(mine / "ca.pem", "belongs to nobody, who could change what root trusts")
    assert "sudo -u nobody rossec" in hint
    assert "a ROSSEC_HOME that root owns" in hint
    as_another(monkeypatch)
    assert "(sudo -u '#4242' rossec ...)" in refused(mine / "ca.pem", "belongs to user 4242")


def test_a_file_of_somebody_else_in_ones_own_directory(mine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    as_another(monkeypatch)
    monkeypatch.setattr(ownership, "check_directory", lambda path: None)
    refused(mine / "ca.pem", "ca.pem belongs to user 4242")


@pytest.fixture
def groups(monkeypatch: pytest.MonkeyPatch) -> list[SimpleNamespace]:
    """Who is in the group 77; user 5 is its owner."""
    users = [SimpleNamespace(pw_name="robot", pw_uid=5, pw_gid=77)]
    group = SimpleNamespace(gr_name="robot", gr_mem=[])
    monkeypatch.setattr(pwd, "getpwall", lambda: users)
    monkeypatch.setattr(pwd, "getpwuid", {5: users[0]}.__getitem__)
    monkeypatch.setattr(grp, "getgrgid", {77: group}.__getitem__)
    ownership._is_user_private_group.cache_clear()
    return [group, *users]


def test_a_group_of_ones_own_counts_as_oneself(groups: list[SimpleNamespace]) -> None:
    groups[0].gr_mem = ["robot", "root"]
    assert ownership._is_user_private_group(77, 5)


@pytest.mark.parametrize("member", ["eve", "robot"])
def test_a_group_of_more_does_not(
    groups: list[SimpleNamespace], monkeypatch: pytest.MonkeyPatch, member: str
) -> None:
    if member == "eve":
        groups[0].gr_mem = ["eve"]
    else:
        eve = SimpleNamespace(pw_name="eve", pw_uid=6, pw_gid=77)
        monkeypatch.setattr(pwd, "getpwall", lambda: [groups[1], eve])
    assert not ownership._is_user_private_group(77, 5)


def test_a_group_whose_users_are_not_listed_does_not(groups: list[SimpleNamespace]) -> None:
    """A directory service answers who a user is, and need not list who has a group."""
    groups[0].gr_name = "domain users"
    assert not ownership._is_user_private_group(77, 5)


@pytest.mark.parametrize("pair", [(78, 5), (77, 6)])
def test_a_group_nobody_can_name_does_not(groups: list[SimpleNamespace], pair: tuple[int, int]) -> None:
    assert not ownership._is_user_private_group(*pair)


def test_a_file_for_the_group(mine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (mine / "ca.pem").chmod(0o664)
    monkeypatch.setattr(ownership, "_is_user_private_group", lambda group, owner: True)
    assert read(mine / "ca.pem") == b"anchor"
    monkeypatch.setattr(os, "getxattr", lambda path, name: b"a list of users")
    refused(mine / "ca.pem", "can be written by others")
    monkeypatch.undo()
    monkeypatch.setattr(ownership, "_is_user_private_group", lambda group, owner: False)
    refused(mine / "ca.pem", "can be written by others")
