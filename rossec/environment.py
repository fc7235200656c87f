"""ROSSEC_HOME, the directory of all files of rossec, from the environment."""

from collections.abc import Mapping
from pathlib import Path

from ca.keys import ownership
from rossec.errors import ConfigurationError


def rossec_home(environ: Mapping[str, str]) -> Path:
    """ROSSEC_HOME, by default `~/.local/share/rossec`.

    Raises:
        ConfigurationError: not an absolute path, or the home directory is unknown.
    """
    value = environ.get("ROSSEC_HOME", "~/.local/share/rossec")
    try:
        path = Path(value).expanduser()
    except RuntimeError as error:  # no such user, or one that has no home
        raise ConfigurationError(
            f"{value.partition('/')[0]} is no home directory", "set ROSSEC_HOME to an absolute path"
        ) from error
    if not path.is_absolute():
        raise ConfigurationError(f"ROSSEC_HOME is {value!r}", "give it an absolute path")
    return path


def own_home(environ: Mapping[str, str]) -> Path:
    """`rossec_home`, if only its owner can write there; it need not exist yet.

    Raises:
        ConfigurationError: as for `rossec_home`.
        PathRefused: it belongs to another user, or others can write in it.
    """
    path = rossec_home(environ)
    ownership.check_directory(path)
    return path
