"""Files that must never be half written, overwritten by accident, or readable by others.

A disk that is full, failing or read-only raises `NotWritten`: the reason, and that the old content
is unchanged, since nothing is damaged.
"""

import ctypes
import errno
import fcntl
import os
import re
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from dataclasses import replace as changed
from functools import partial
from pathlib import Path
from typing import BinaryIO, Final, TextIO

from ca.keys import ownership
from rossec.errors import ConfigurationError, NotWritten

_DISK: Final = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS}
_CREATE: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2  # fcntl.h, linux/fs.h
_NO_EXCHANGE: Final = {errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP, errno.EXDEV}


@dataclass(frozen=True)
class Owned:
    """What the part that owns files in a directory says of them."""

    pattern: str  # of their paths below it, a regular expression of the whole
    kept: bool = True  # whether they are in a backup
    public: bool = False  # whether others may read them
    # where a backup replaces the home they are in, they are newer than those of the backup, and an older
    # one would bring back what was taken away
    stays: bool = False

    def below(self, directory: str) -> "Owned":
        return changed(self, pattern=f"{re.escape(directory)}/(?:{self.pattern})")

    def names(self, path: str) -> bool:
        return re.fullmatch(self.pattern, path) is not None


def make_private_directory(path: Path) -> None:
    if not path.parent.is_dir():  # mkdir(parents=True) would ignore the mode for those above
        make_private_directory(path.parent)
    path.mkdir(mode=0o700, exist_ok=True)
    ownership.check_directory(path)


def create(path: Path, data: bytes, mode: int = 0o600) -> None:
    """Write a new file, durable on return."""
    with _disk_errors(path):
        _create(path, data, mode)


def replace(path: Path, data: bytes, mode: int = 0o600, *, keep: bool = False) -> None:
    """Write or replace a file in one step: a reader or a crash sees the old or the new content.

    With `keep` a file that is there keeps its mode, its owner and its group.
    """
    if path.is_symlink() or (path.exists() and not path.is_file() and not path.is_dir()):
        raise ConfigurationError(
            f"{path} is not a plain file and is not replaced", "name a new file, or a plain one"
        )
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
    with _disk_errors(path):
        known = path.stat() if keep and path.exists() else None
        _create(temporary, data, mode if known is None else known.st_mode & 0o600)
        try:
            if known is not None:
                made = temporary.stat()
                if (made.st_uid, made.st_gid) != (known.st_uid, known.st_gid):
                    os.chown(temporary, known.st_uid, known.st_gid)
                temporary.chmod(stat.S_IMODE(known.st_mode))
            temporary.replace(path)
        except OSError:
            temporary.unlink(missing_ok=True)
            raise
        sync_directory(path.parent)


def _create(path: Path, data: bytes, mode: int) -> None:
    try:
        descriptor = os.open(path, _CREATE, mode)
    except FileExistsError:
        raise ConfigurationError(
            f"{path} exists and is not overwritten", "move it away if it is not needed"
        ) from None
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    except OSError:
        path.unlink(missing_ok=True)
        raise
    sync_directory(path.parent)


@contextmanager
def _disk_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno not in _DISK:
            raise
        raise NotWritten(
            f"{path.name} was not written: {os.strerror(error.errno).lower()}",
            f"nothing is damaged, {path} is as it was: make room, then do it again",
        ) from error


def commit_directory(temporary: Path, path: Path) -> None:
    # First: after a crash a directory that has its name is whole.
    sync_directory(temporary)
    try:
        temporary.rename(path)
    except OSError as error:
        if error.errno not in {errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR}:
            raise
        raise ConfigurationError(
            f"{path} exists and is not overwritten", "move it away if it is not needed"
        ) from error
    sync_directory(path.parent)


def exchange(one: Path, other: Path) -> None:
    """Give each of two directories the path of the other in one step, durable on return.

    A crash leaves both as they were, or both exchanged: at no moment is there nothing at a path.
    """
    library = ctypes.CDLL(None, use_errno=True)
    try:
        done = library.renameat2(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE)
        number = ctypes.get_errno() if done else 0
    except AttributeError:  # a C library without it
        number = errno.ENOSYS
    if number in _NO_EXCHANGE:
        raise ConfigurationError(
            f"the file system of {other} cannot exchange two directories in one step",
            f"move {other} away by hand, then do it again",
        )
    if number:
        raise OSError(number, os.strerror(number), str(other))
    for directory in {one, other, one.parent, other.parent}:
        sync_directory(directory)


def replace_directory(new: Path, target: Path, aside: Path) -> None:
    """Put the directory `new` in the place of `target`, which is at `aside` from then on.

    The last step is an exchange: after a crash nothing is left to do, and what was replaced is
    where it belongs. A crash before it leaves `new` at `aside`.
    """
    made = new.stat().st_ino
    new.rename(aside)
    try:
        exchange(aside, target)
    except BaseException:
        if aside.stat().st_ino == made:
            aside.rename(new)
        raise


def lock_file(path: Path, busy: ConfigurationError) -> int:
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
    descriptor = os.open(path, flags, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise busy from error
    return descriptor


@contextmanager
def locked_directory(directory: Path) -> Iterator[None]:
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def read(path: Path, limit: int, missing: ConfigurationError | None = None) -> bytes:
    """Content of a file of at most `limit` bytes."""
    try:
        with path.open("rb") as file:
            return _bounded(file, path, limit)
    except FileNotFoundError:
        raise missing or ConfigurationError(f"there is no {path}") from None


def _bounded(file: BinaryIO, path: Path, limit: int) -> bytes:
    data = file.read(limit + 1)
    if len(data) > limit:
        raise ConfigurationError(f"{path} is larger than {limit} bytes", "is it the right file?")
    return data


def read_own(path: Path, limit: int, missing: ConfigurationError, *, link: bool = False) -> bytes:
    """As `read`, of a file that is trusted: only its owner may have written it.

    With `link` it may be a symbolic link, as the operator's own files are; its target is checked.
    """
    try:
        descriptor = ownership.open_trusted(path, link=link)
    except FileNotFoundError:
        raise missing from None
    with os.fdopen(descriptor, "rb") as file:
        return _bounded(file, path, limit)


def append_own(path: Path) -> int:
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    descriptor = os.open(path, flags, 0o600)
    try:
        ownership.check_file(path, os.fstat(descriptor))
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def open_text(path: Path, missing: ConfigurationError) -> TextIO:
    """Open a text file of any length; invalid characters are replaced."""
    try:  # without O_NONBLOCK a FIFO blocks the caller until it is written to
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except FileNotFoundError:
        raise missing from None
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise ConfigurationError(f"{path} is not a regular file", "copy its content to one")
    return os.fdopen(descriptor, encoding="utf-8", errors="replace")


def lines(file: TextIO, longest: int) -> Iterator[str]:
    """The lines of an open file; one of more than `longest` characters is split."""
    return iter(partial(file.readline, longest), "")


def sync_directory(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
