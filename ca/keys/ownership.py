"""Whom the files and directories belong to that are believed without a signature. A shell.

What decides whom a node trusts lies in files: who can change them decides in its place. So a file
is believed only when it belongs to the user rossec runs as, or to root, and nobody else can write
it; it is opened first and judged by what was opened (a path may point elsewhere by now). The same
holds for its directory and all above it, up to the root and through every symbolic link on the
way; a directory above may be open to others if it is sticky, as /tmp is, for then nobody can take
away what is another's (stat(2) S_ISVTX). OpenSSH asks the same (StrictModes in sshd_config(5)).

A group that is the owner's alone counts as the owner, as on systems where each user has one and the
umask is 002. It has its owner's name (pam_umask(8) usergroups): a directory service need not say
who else is in one. Root is asked no less: what it finds in a user's directory, that user wrote.
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
# O_NONBLOCK: opening a FIFO must not hang; it is refused as no regular file right after.
_READ: Final = os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK


def check_directory(path: Path) -> None:
    """Return if nobody else can put anything into `path`, or put another directory in its place.

    What does not exist yet is not asked.

    Raises:
        PathRefused: who can.
    """
    for place, status, is_last in _walk(path):
        _check_owner(place, status)
        is_sticky = status.st_mode & stat.S_ISVTX
        if stat.S_ISDIR(status.st_mode) and (is_last or not is_sticky):
            _check_writers(place, status)


def check_file(path: Path, status: os.stat_result) -> None:
    """Judge a file by what was opened.

    Raises:
        PathRefused: it is no plain file, or somebody else can write it.
    """
    if not stat.S_ISREG(status.st_mode):
        raise PathRefused(f"{path} is not a plain file", "is it the right one?")
    _check_owner(path, status)
    _check_writers(path, status)


def check_trusted(path: Path) -> None:
    """Judge a file that is believed without opening it: for those that others open.

    Who opens and closes a file gives up every lock its process has on it (fcntl(2)), SQLite's too.
    What is named is what will be opened, since nobody else can change names in its directory.

    Raises:
        FileNotFoundError: there is none.
        PathRefused: somebody else could have written it.
    """
    check_directory(path.parent)
    status = os.lstat(path)
    if stat.S_ISLNK(status.st_mode):
        raise PathRefused(f"{path} is a symbolic link", "put the file itself there")
    check_file(path, status)


def open_trusted(path: Path, *, link: bool = False) -> int:
    """Open a file that is believed, for reading; returns its descriptor.

    Args:
        path: of the file.
        link: the operator may have put a symbolic link there; where it leads is judged.

    Raises:
        FileNotFoundError: there is none.
        PathRefused: somebody else could have written it.
    """
    check_directory(path.parent)
    if not link and path.is_symlink():
        raise PathRefused(f"{path} is a symbolic link", "put the file itself there")
    descriptor = os.open(path, _READ | (0 if link else os.O_NOFOLLOW))
    try:
        check_file(path, os.fstat(descriptor))
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _walk(path: Path) -> Iterator[tuple[Path, os.stat_result, bool]]:
    """Every directory and every link between the root and `path`, as the kernel walks it.

    The last is `path` itself, and said to be; where that does not exist, none is.
    """
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
    owner, word = _user(status.st_uid)
    if os.geteuid() == 0:
        raise PathRefused(
            f"{path} belongs to {owner}, and this is root: root would do what {owner} writes there",
            f"run it as {owner} (sudo -u {word} rossec ...), or use a ROSSEC_HOME that is root's",
        )
    raise PathRefused(
        f"{path} belongs to {owner}, who could change what is trusted here",
        "use a ROSSEC_HOME of your own, in a directory of yours or of root",
    )


def _check_writers(path: Path, status: os.stat_result) -> None:
    others = status.st_mode & stat.S_IWOTH
    group = status.st_mode & stat.S_IWGRP
    if others or (group and not _is_private_group(path, status)):
        if status.st_mode & stat.S_ISVTX:
            raise PathRefused(f"{path} can be written by others", "use a directory of yours in it")
        raise PathRefused(
            f"{path} can be written by others",
            f"look what is in it; if nobody used that: chmod go-w {path}",
        )


def _is_private_group(path: Path, status: os.stat_result) -> bool:
    """Whether writable by the group means: by the owner alone."""
    try:
        os.getxattr(path, _ACL)
    except OSError:
        return _is_user_private_group(status.st_gid, status.st_uid)
    return False  # with a list of others the bits of the group are the most that any of them may


@lru_cache(maxsize=64)
def _is_user_private_group(group: int, owner: int) -> bool:
    """Whether nobody but `owner`, and root, is in the group."""
    try:
        found, name = grp.getgrgid(group), pwd.getpwuid(owner).pw_name
    except KeyError:
        return False
    members, names = set(found.gr_mem), {name, "root"}
    belong = {user.pw_name for user in pwd.getpwall() if user.pw_gid == group and user.pw_uid}
    return found.gr_name == name and members | belong <= names


def _user(number: int) -> tuple[str, str]:
    """How to name a user in a sentence, and to sudo."""
    try:
        name = pwd.getpwuid(number).pw_name
    except KeyError:
        return f"user {number}", f"'#{number}'"
    return name, name
