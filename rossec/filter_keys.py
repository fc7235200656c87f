"""The keys of a node's pseudonyms, one file each: random, created on first use, never replaced."""

import secrets
from pathlib import Path
from typing import Final

from ca.errors import PathRefused
from grants.filters.hashing import FILTER_KEY_SIZE, check_key_name
from rossec import files
from rossec.errors import ConfigurationError

DIRECTORY: Final = "filters"  # of a node
OWNED: Final = (files.Owned(r"[a-z][a-z0-9_-]{0,31}\.key"),)


def filter_key(directory: Path, name: str) -> bytes:
    """The key `name`, 32 random bytes; created on first use.

    Raises:
        FilterRefused: not a key name.
        ConfigurationError: the file does not hold a key.
    """
    path = directory / f"{check_key_name(name)}.key"
    files.make_private_directory(directory)
    with files.locked_directory(directory):
        if not path.exists():
            files.create(path, secrets.token_bytes(FILTER_KEY_SIZE))
    missing = ConfigurationError(f"there is no filter key {name} any more", f"it was {path}")
    try:
        key = files.read_own(path, FILTER_KEY_SIZE, missing)
    except PathRefused as error:  # a peer may read this: no path in it
        raise ConfigurationError(
            f"others could have written the filter key {name}", f"{error}: {error.hint}"
        ) from error
    if len(key) != FILTER_KEY_SIZE:
        raise ConfigurationError(
            # A peer may read this: no path in it.
            f"the filter key {name} is not a key of {FILTER_KEY_SIZE} bytes",
            f"move {path} away: a new one is made, and pseudonyms change",
        )
    return key
