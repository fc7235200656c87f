import os
import stat
from pathlib import Path

import pytest

from rossec import files
from rossec.errors import ConfigurationError

MISSING = ConfigurationError("there is none", "make one")


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_directory_is_for_its_owner_alone_and_kept(tmp_path: Path) -> None:
    files.make_private_directory(tmp_path / "a" / "b")
    (tmp_path / "a" / "b" / "x").touch()
    files.make_private_directory(tmp_path / "a" / "b")
    assert mode(tmp_path / "a" / "b") == 0o700
    assert (tmp_path / "a" / "b" / "x").exists()


def test_the_missing_directories_above_are_private_too(tmp_path: Path) -> None:
    files.make_private_directory(tmp_path / "a" / "b" / "c")
    assert [mode(tmp_path / part) for part in ("a", "a/b", "a/b/c")] == [0o700] * 3


def test_a_finished_directory_takes_its_place_and_no_other(tmp_path: Path) -> None:
    for name in ("begun", "again"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "x").write_text(name)
    files.settle(tmp_path / "begun", tmp_path / "done")
    with pytest.raises(ConfigurationError, match="done exists and is not overwritten"):
        files.settle(tmp_path / "again", tmp_path / "done")
    assert (tmp_path / "done" / "x").read_text() == "begun"
    with pytest.raises(FileNotFoundError):
        files.settle(tmp_path / "again", tmp_path / "missing" / "done")


def test_a_new_file_is_private_and_never_overwritten(tmp_path: Path) -> None:
    files.create(tmp_path / "secret", b"one")
    assert mode(tmp_path / "secret") == 0o600
    with pytest.raises(ConfigurationError, match="is not overwritten"):
        files.create(tmp_path / "secret", b"two")
    assert (tmp_path / "secret").read_bytes() == b"one"


def test_a_dangling_link_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    with pytest.raises((ConfigurationError, OSError)):
        files.create(tmp_path / "link", b"x")
    assert not (tmp_path / "elsewhere").exists()


def test_replacing_leaves_nothing_beside(tmp_path: Path) -> None:
    files.replace(tmp_path / "list", b"old")
    files.replace(tmp_path / "list", b"new", 0o644)
    assert (tmp_path / "list").read_bytes() == b"new"
    assert mode(tmp_path / "list") == 0o644
    assert list(tmp_path.iterdir()) == [tmp_path / "list"]


def test_a_failed_write_leaves_the_old_content(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files.replace(tmp_path / "list", b"old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        files.replace(tmp_path / "list", b"new")
    assert (tmp_path / "list").read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [tmp_path / "list"]


def test_a_failed_rename_leaves_nothing_beside(tmp_path: Path) -> None:
    (tmp_path / "list").mkdir()
    with pytest.raises(OSError):  # noqa: PT011 - the number differs by system
        files.replace(tmp_path / "list", b"new")
    assert list(tmp_path.iterdir()) == [tmp_path / "list"]


def test_reading_is_bounded(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"12345")
    assert files.read(tmp_path / "x", 5, MISSING) == b"12345"
    with pytest.raises(ConfigurationError, match="larger than 4 bytes"):
        files.read(tmp_path / "x", 4, MISSING)
    with pytest.raises(ConfigurationError, match="there is none"):
        files.read(tmp_path / "y", 4, MISSING)


def test_a_file_is_held_by_one_until_it_lets_go(tmp_path: Path) -> None:
    busy = ConfigurationError("busy")
    held = files.hold(tmp_path / "lock", busy)
    with pytest.raises(ConfigurationError, match="busy"):
        files.hold(tmp_path / "lock", busy)
    os.close(held)
    os.close(files.hold(tmp_path / "lock", busy))
    assert stat.S_IMODE((tmp_path / "lock").stat().st_mode) == 0o600
    (tmp_path / "link").symlink_to(tmp_path / "lock")
    with pytest.raises(OSError, match="symbolic"):
        files.hold(tmp_path / "link", busy)
