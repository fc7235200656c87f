"""Files that must never be half written, overwritten by accident, or readable by others.

A disk that is full, failing or read-only raises `NotWritten`: the reason, and that the old content
is unchanged, since nothing is damaged.
"""

import errno
import fcntl
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import BinaryIO, Final, TextIO

from ca.keys import ownership
from rossec.errors import ConfigurationError, NotWritten

_DISK: Final = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS}
_CREATE: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC


def make_private_directory(path: Path) -> None:
    """Create `path` and missing parents, for the owner alone; an existing one is kept.

    Raises:
        PathRefused: others can write there.
    """
    if not path.parent.is_dir():  # mkdir(parents=True) would ignore the mode for those above
        make_private_directory(path.parent)
    path.mkdir(mode=0o700, exist_ok=True)
    ownership.check_directory(path)


def create(path: Path, data: bytes, mode: int = 0o600) -> None:
    """Write a new file, durable on return.

    Raises:
        ConfigurationError: the file exists already.
        NotWritten: the disk refused it; nothing is left behind.
    """
    with _disk_errors(path):
        _create(path, data, mode)


def replace(path: Path, data: bytes, mode: int = 0o600) -> None:
    """Write or replace a file in one step: a reader or a crash sees the old or the new content.

    Raises:
        ConfigurationError: the path is a link, a device or the like, which is not replaced.
        NotWritten: the disk refused it; the old content is unchanged.
    """
    if path.is_symlink() or (path.exists() and not path.is_file() and not path.is_dir()):
        raise ConfigurationError(
            f"{path} is not a plain file and is not replaced", "name a new file, or a plain one"
        )
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
    with _disk_errors(path):
        _create(temporary, data, mode)
        try:
            temporary.replace(path)
        except OSError:
            temporary.unlink(missing_ok=True)
            raise
        _sync_directory(path.parent)


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
    _sync_directory(path.parent)


@contextmanager
def _disk_errors(path: Path) -> Iterator[None]:
    """Raise `NotWritten` for disk errors. A peer may read its first line: no path in it."""
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
    """Rename a finished directory to `path`, durable on return: all of it or nothing.

    Raises:
        ConfigurationError: `path` exists; it is not changed.
    """
    _sync_directory(temporary)
    try:
        temporary.rename(path)
    except OSError as error:
        if error.errno not in {errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR}:
            raise
        raise ConfigurationError(
            f"{path} exists and is not overwritten", "move it away if it is not needed"
        ) from error
    _sync_directory(path.parent)


def lock_file(path: Path, busy: ConfigurationError) -> int:
    """Lock `path` for this process until the descriptor returned is closed, or it exits.

    Raises:
        ConfigurationError: `busy`, when another process holds it.
    """
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
    """Lock `directory` against other callers of this: for reading, then writing."""
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def read(path: Path, limit: int, missing: ConfigurationError | None = None) -> bytes:
    """Content of a file of at most `limit` bytes.

    Raises:
        ConfigurationError: `missing` when there is no file (without it, a plain one); too large.
    """
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

    Args:
        path, limit, missing: as for `read`.
        link: it may be a symbolic link, as the operator's own files are; its target is checked.

    Raises:
        ConfigurationError: as for `read`.
        PathRefused: see `ca.keys.ownership`.
    """
    try:
        descriptor = ownership.open_trusted(path, link=link)
    except FileNotFoundError:
        raise missing from None
    with os.fdopen(descriptor, "rb") as file:
        return _bounded(file, path, limit)


def append_own(path: Path) -> int:
    """Open a log to append to, created for its owner alone; returns its descriptor.

    Raises:
        PathRefused: not a plain file, or of another owner, who could read it.
        OSError: it cannot be opened.
    """
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    descriptor = os.open(path, flags, 0o600)
    try:
        ownership.check_file(path, os.fstat(descriptor))
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def open_text(path: Path, missing: ConfigurationError) -> TextIO:
    """Open a text file of any length; invalid characters are replaced.

    Raises:
        ConfigurationError: `missing` when there is no file, another when it is not a regular one.
    """
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


def _sync_directory(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
