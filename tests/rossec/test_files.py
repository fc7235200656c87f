import ctypes
import errno
import fcntl
import os
import resource
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from ca.errors import PathRefused
from rossec import files
from rossec.errors import ConfigurationError, NotWritten


@contextmanager
def no_room() -> Iterator[None]:
    """No file may grow, as on a full disk (setrlimit(2); Python ignores its signal)."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


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
    files.commit_directory(tmp_path / "begun", tmp_path / "done")
    with pytest.raises(ConfigurationError, match="done exists and is not overwritten"):
        files.commit_directory(tmp_path / "again", tmp_path / "done")
    assert (tmp_path / "done" / "x").read_text() == "begun"
    with pytest.raises(FileNotFoundError):
        files.commit_directory(tmp_path / "again", tmp_path / "missing" / "done")


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


def test_a_failed_write_leaves_the_old_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files.replace(tmp_path / "list", b"old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(NotWritten, match="no space"):
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
    with pytest.raises(ConfigurationError, match=f"there is no {tmp_path / 'y'}"):
        files.read(tmp_path / "y", 4)


def test_a_lock_file_has_one_holder(tmp_path: Path) -> None:
    busy = ConfigurationError("busy")
    held = files.lock_file(tmp_path / "lock", busy)
    with pytest.raises(ConfigurationError, match="busy"):
        files.lock_file(tmp_path / "lock", busy)
    os.close(held)
    os.close(files.lock_file(tmp_path / "lock", busy))
    assert stat.S_IMODE((tmp_path / "lock").stat().st_mode) == 0o600
    (tmp_path / "link").symlink_to(tmp_path / "lock")
    with pytest.raises(OSError, match="symbolic"):
        files.lock_file(tmp_path / "link", busy)


def test_only_plain_files_are_replaced(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    os.mkfifo(tmp_path / "pipe")
    for name in ("link", "pipe"):
        with pytest.raises(ConfigurationError, match="is not a plain file and is not replaced"):
            files.replace(tmp_path / name, b"x")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "pipe"]


def test_a_trusted_file_is_its_owners(tmp_path: Path) -> None:
    (tmp_path / "own").write_bytes(b"12345")
    assert files.read_own(tmp_path / "own", 5, MISSING) == b"12345"
    with pytest.raises(ConfigurationError, match="larger than 4"):
        files.read_own(tmp_path / "own", 4, MISSING)
    with pytest.raises(ConfigurationError, match="there is none"):
        files.read_own(tmp_path / "missing", 4, MISSING)
    (tmp_path / "own").chmod(0o666)
    for open_it in (lambda path: files.read_own(path, 5, MISSING), files.append_own):
        with pytest.raises(PathRefused, match="can be written by others"):
            open_it(tmp_path / "own")


def test_lines_are_bounded(tmp_path: Path) -> None:
    (tmp_path / "log").write_text("ab\n" + "x" * 9 + "\nc")
    with (tmp_path / "log").open() as file:
        assert list(files.lines(file, 4)) == ["ab\n", "xxxx", "xxxx", "x\n", "c"]


def test_a_full_disk_leaves_the_old_content(tmp_path: Path) -> None:
    path = tmp_path / "revocations.cose"
    files.replace(path, b"old")
    with no_room(), pytest.raises(NotWritten, match=r"^revocations.cose was not written: ") as no:
        files.replace(path, b"new")
    assert no.value.hint == f"nothing is damaged, {path} is as it was: make room, then do it again"
    assert path.read_bytes() == b"old"
    with no_room(), pytest.raises(NotWritten, match="fresh was not written: file too large"):
        files.create(tmp_path / "fresh", b"new")
    assert list(tmp_path.iterdir()) == [path]


def test_other_errors_are_not_disk_errors(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No such file") as caught:
        files.replace(tmp_path / "missing" / "file", b"x")
    assert caught.value.errno == errno.ENOENT


def test_two_directories_are_exchanged_in_one_step(tmp_path: Path) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    for each in (one, other):
        each.mkdir()
        (each / "name").write_text(each.name)
    files.exchange(one, other)
    assert [(each / "name").read_text() for each in (one, other)] == ["other", "one"]
    with pytest.raises(FileNotFoundError):
        files.exchange(one, tmp_path / "none")
    assert (one / "name").exists()


class _Library:
    """A C library as on systems that cannot."""

    def renameat2(self, *_: object) -> int:
        ctypes.set_errno(errno.EINVAL)
        return -1


@pytest.mark.parametrize("library", [_Library(), object()], ids=["refuses", "has no such call"])
def test_a_file_system_that_cannot_exchange_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, library: object
) -> None:
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: library)
    one, other = tmp_path / "one", tmp_path / "other"
    one.mkdir()
    other.mkdir()
    with pytest.raises(ConfigurationError, match="cannot exchange") as caught:
        files.exchange(one, other)
    assert str(other) in caught.value.hint


def test_what_an_owner_declares_is_about_whole_paths() -> None:
    owned = files.Owned(r"[a-z]\.key|b")
    assert [owned.names(path) for path in ("a.key", "b", "a.keys", "x/b", "")] == [
        True,
        True,
        False,
        False,
        False,
    ]
    below = owned.below("x.y")
    assert [below.names(path) for path in ("x.y/a.key", "x.y/b", "xzy/b", "b")] == [True, True, False, False]


def test_a_directory_takes_the_place_of_another_that_is_kept_aside(tmp_path: Path) -> None:
    new, target, aside = tmp_path / "new", tmp_path / "target", tmp_path / "aside"
    for each in (new, target):
        each.mkdir()
        (each / "name").write_text(each.name)
    files.replace_directory(new, target, aside)
    assert (target / "name").read_text() == "new"
    assert (aside / "name").read_text() == "target"
    assert not new.exists()
    target.rename(tmp_path / "new")
    with pytest.raises(FileNotFoundError):
        files.replace_directory(new, target, tmp_path / "aside2")
    assert (new / "name").read_text() == "new", "it is where it was"


def test_what_replaces_a_file_may_keep_its_mode(tmp_path: Path) -> None:
    path = tmp_path / "policy.yaml"
    path.write_text("old")
    path.chmod(0o644)
    files.replace(path, b"new", keep=True)
    assert (path.read_text(), mode(path)) == ("new", 0o644)
    files.replace(path, b"newer")
    assert mode(path) == 0o600


def test_a_directory_is_locked_for_one_at_a_time(tmp_path: Path) -> None:
    with files.locked_directory(tmp_path):
        descriptor = os.open(tmp_path, os.O_RDONLY)
        with pytest.raises(BlockingIOError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.close(descriptor)
    with files.locked_directory(tmp_path):
        pass


def test_a_log_is_its_owners_and_appended_to(tmp_path: Path) -> None:
    path = tmp_path / "audit.log"
    for text in (b"one\n", b"two\n"):
        descriptor = files.append_own(path)
        os.write(descriptor, text)
        os.close(descriptor)
    assert (path.read_bytes(), mode(path)) == (b"one\ntwo\n", 0o600)
    path.chmod(0o666)
    with pytest.raises(PathRefused):
        files.append_own(path)


def test_text_is_read_from_plain_files_alone(tmp_path: Path) -> None:
    (tmp_path / "text").write_bytes(b"caf\xe9\n")
    with files.open_text(tmp_path / "text", MISSING) as file:
        assert file.read() == "caf\ufffd\n"
    with pytest.raises(ConfigurationError, match="there is none"):
        files.open_text(tmp_path / "none", MISSING)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ConfigurationError, match="not a regular file"):
        files.open_text(tmp_path / "pipe", MISSING)
