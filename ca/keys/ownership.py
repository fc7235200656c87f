"""Owner and mode of files and directories that are trusted without a signature. Does I/O.

A file is trusted only if it belongs to the user rossec runs as, or to root, and no other user can
write it. The same holds for its directory and all above it, through every symbolic link. OpenSSH
does the same (StrictModes, sshd_config(5)).
"""

import grp
import os
import pwd
import stat
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Final

from ca.errors import PathRefused

_ACL: Final = "system.posix_acl_access"
_MAX_LINKS: Final = 40  # as the kernel follows
# O_NONBLOCK: opening a FIFO must not hang; it is refused afterwards, as not a regular file.
_READ: Final = os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK


def check_directory(path: Path) -> None:
    """Return if no other user can write to the directory `path`, or replace it."""
    # Components that do not exist yet are not checked.
    for part, status, is_last in _walk(path):
        _check_owner(part, status)
        # One above may be writable by others if it is sticky, as /tmp is (stat(2) S_ISVTX): nobody else can
        # then rename or remove what is in it.
        is_sticky = status.st_mode & stat.S_ISVTX
        if stat.S_ISDIR(status.st_mode) and (is_last or not is_sticky):
            _check_writers(part, status)


def check_file(path: Path, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise PathRefused(f"{path} is not a regular file", "is it the right one?")
    _check_owner(path, status)
    _check_writers(path, status)


def check_trusted(path: Path) -> None:
    """Check a trusted file without opening it, for files that a library opens."""
    # Closing a file drops every lock its process has on it (fcntl(2)), those of SQLite too. The path will be
    # the same file when opened: no other user can change names in its directory.
    check_directory(path.parent)
    status = os.lstat(path)
    if stat.S_ISLNK(status.st_mode):
        raise PathRefused(f"{path} is a symbolic link", "put the file itself there")
    check_file(path, status)


def open_trusted(path: Path, *, link: bool = False) -> int:
    check_directory(path.parent)
    if not link and path.is_symlink():
        raise PathRefused(f"{path} is a symbolic link", "put the file itself there")
    # Opened first, and the open file is checked: the path may name another one a moment later.
    descriptor = os.open(path, _READ | (0 if link else os.O_NOFOLLOW))
    try:
        check_file(path, os.fstat(descriptor))
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _walk(path: Path) -> Iterator[tuple[Path, os.stat_result, bool]]:
    # The boolean is true for `path` itself, which is not reached if it does not exist.
    here, links = Path("/"), 0
    rest = [*reversed(path.absolute().parts[1:])]
    yield here, os.lstat(here), not rest
    while rest:
        part = rest.pop()
        here = here.parent if part == ".." else here / part
        try:
            status = os.lstat(here)
        except FileNotFoundError:
            return
        yield here, status, not rest
        if stat.S_ISLNK(status.st_mode):
            links += 1
            if links > _MAX_LINKS:
                raise PathRefused(f"{path} is behind too many symbolic links")
            target = here.readlink()
            rest += reversed(target.parts[1:] if target.is_absolute() else target.parts)
            here = Path("/") if target.is_absolute() else here.parent
            if not rest:  # a link to "/" or "."
                yield here, os.lstat(here), True


def _check_owner(path: Path, status: os.stat_result) -> None:
    if status.st_uid in {os.geteuid(), 0}:
        return
    try:
        owner = word = pwd.getpwuid(status.st_uid).pw_name
    except KeyError:
        owner, word = f"user {status.st_uid}", f"'#{status.st_uid}'"
    # Root is held to the same: files in a user's directory were written by that user.
    if os.geteuid() == 0:
        raise PathRefused(
            f"{path} belongs to {owner}, who could change what root trusts here",
            f"run it as {owner} (sudo -u {word} rossec ...), or use a ROSSEC_HOME that root owns",
        )
    raise PathRefused(
        f"{path} belongs to {owner}, who could change what is trusted here",
        "use a ROSSEC_HOME of your own, in a directory of yours or of root",
    )


def _check_writers(path: Path, status: os.stat_result) -> None:
    is_safe = not status.st_mode & stat.S_IWOTH
    if is_safe and status.st_mode & stat.S_IWGRP:
        try:
            os.getxattr(path, _ACL)
            is_safe = False  # with an ACL, the group bits are its mask
        except OSError:
            is_safe = _is_user_private_group(status.st_gid, status.st_uid)
    if not is_safe:
        if status.st_mode & stat.S_ISVTX:
            raise PathRefused(f"{path} can be written by others", "use a directory of yours in it")
        raise PathRefused(
            f"{path} can be written by others", f"check its content; if it was not changed: chmod go-w {path}"
        )


@lru_cache(maxsize=64)
def _is_user_private_group(group: int, owner: int) -> bool:
    try:
        found, name = grp.getgrgid(group), pwd.getpwuid(owner).pw_name
    except KeyError:
        return False
    # A group with its owner alone counts as the owner, as on systems with umask 002.
    members, names = set(found.gr_mem), {name, "root"}
    belong = {user.pw_name for user in pwd.getpwall() if user.pw_gid == group and user.pw_uid}
    return found.gr_name == name and members | belong <= names
