"""Files that must never be half written, overwritten by accident, or readable by others."""

import errno
import fcntl
import os
import secrets
from pathlib import Path
from typing import Final

from rossec.errors import ConfigurationError

_CREATE: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC


def make_private_directory(path: Path) -> None:
    """Create `path` and what is missing above it, for the owner alone; an existing one is kept."""
    if not path.parent.is_dir():  # mkdir(parents=True) would ignore the mode for those above
        make_private_directory(path.parent)
    path.mkdir(mode=0o700, exist_ok=True)


def create(path: Path, data: bytes, mode: int = 0o600) -> None:
    """Write a new file, durable on return.

    Raises:
        ConfigurationError: the file exists already.
    """
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


def replace(path: Path, data: bytes, mode: int = 0o600) -> None:
    """Write or replace a file in one step: a reader or a crash sees the old or the new content."""
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
    create(temporary, data, mode)
    try:
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    _sync_directory(path.parent)


def settle(temporary: Path, path: Path) -> None:
    """Give a finished directory its name, durable on return: it is there whole or not at all.

    Raises:
        ConfigurationError: there is something at `path`; it is not touched.
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


def hold(path: Path, busy: ConfigurationError) -> int:
    """Make `path` this process's alone until the descriptor returned is closed, or it dies.

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


def read(path: Path, limit: int, missing: ConfigurationError) -> bytes:
    """Content of a file of at most `limit` bytes.

    Raises:
        ConfigurationError: `missing` when there is no file, another when it is too large.
    """
    try:
        with path.open("rb") as file:
            data = file.read(limit + 1)
    except FileNotFoundError:
        raise missing from None
    if len(data) > limit:
        raise ConfigurationError(f"{path} is larger than {limit} bytes", "is it the right file?")
    return data


def _sync_directory(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
