"""The files of an authority's directory: which there are, and which of them a backup has.

Nothing is listed here. Each part that writes files says of its own what they are, in its `OWNED`:
a part that is added brings its declaration along, and a test holds every file of a home that has
used all of them against this.
"""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

from ca.errors import BackupRefused
from ca.store.backup import MAX_BACKUP
from rossec import filter_keys, home, saved_domains
from rossec.authority import (
    grant_delivery,
    intermediate_home,
    policyfile,
    requests,
    signing,
)
from rossec.authority import home as authority_home
from rossec.authority.console import messages as console
from rossec.authority.keyservice import lock
from rossec.errors import ConfigurationError
from rossec.files import Owned, read_own

_NODE: Final = (
    *home.OWNED, *saved_domains.OWNED,
    *(each.below(filter_keys.DIRECTORY) for each in filter_keys.OWNED),
)  # fmt: skip
OWNED: Final[tuple[Owned, ...]] = (
    *authority_home.OWNED, *intermediate_home.OWNED, *signing.OWNED, *policyfile.OWNED,
    *requests.OWNED, *grant_delivery.OWNED, *lock.OWNED, *console.OWNED,
    *(each.below(authority_home.NODE) for each in _NODE),
)  # fmt: skip
# Older versions put every file there is into a backup, of these places.
_OLDER: Final = re.compile(r"(?:node/|inbox/)?[^/]+")
_TEMPORARY: Final = re.compile(r"(?:.+/)?\.[^/]+")  # of `files.replace`, when it was interrupted


def owner(name: str) -> Owned | None:
    """What its owner says of the file `name`; None: nobody does."""
    return next((each for each in OWNED if each.names(name)), None)


def undeclared(directory: Path) -> list[str]:
    """The files in an authority's directory that no part of rossec has written."""
    return [name for name in _files(directory) if owner(name) is None]


def kept(directory: Path) -> dict[str, bytes]:
    """What a backup has of an authority's directory, except the record.

    Raises:
        PathRefused: another user could have written one of them, or it is a symbolic link.
    """
    content: dict[str, bytes] = {}
    for name in _files(directory):
        found = owner(name)
        if found is None or not found.kept or name == authority_home.RECORD:
            continue
        content[name] = read(directory, name)
    return content


def staying(directory: Path) -> list[str]:
    """The files of an authority's directory that a backup does not replace."""
    found = ((name, owner(name)) for name in _files(directory))
    return [name for name, owned in found if owned is not None and owned.stays]


def read(directory: Path, name: str) -> bytes:
    """One file of an authority's directory.

    Raises:
        PathRefused: another user could have written it, or it is a symbolic link; the policy, the
            operator's own file, may be one.
        ConfigurationError: it was removed meanwhile.
    """
    gone = ConfigurationError(f"{directory / name} was removed meanwhile", "do it again")
    return read_own(directory / name, MAX_BACKUP, gone, link=name == policyfile.NAME)


def restorable(content: Mapping[str, bytes]) -> tuple[dict[str, bytes], list[str]]:
    """The files of a backup that are written, and the names of those that are left out.

    A backup is of whoever made it: only what a part of rossec says is its own, and is kept in
    backups, is written. An older version may have taken other files along from some places.

    Raises:
        BackupRefused: a name that no version has put into a backup.
    """
    found = {name: owner(name) for name in content}
    for name, owned in found.items():
        if owned is None and not _OLDER.fullmatch(name):
            raise BackupRefused(f"{name!a} is not a file of an authority")
    taken = {name for name, owned in found.items() if owned is not None and owned.kept}
    left = sorted(found.keys() - taken)
    return {name: data for name, data in content.items() if name in taken}, left


def mode(name: str) -> int:
    """The mode of the file `name`."""
    found = owner(name)
    return 0o644 if found is not None and found.public else 0o600


def _files(directory: Path) -> Iterable[str]:
    for path in sorted(directory.rglob("*")):
        name = str(path.relative_to(directory))
        if path.is_file() and _TEMPORARY.fullmatch(name) is None:
            yield name
