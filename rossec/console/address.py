"""Where the console of an authority is: written when it begins, for the commands that show codes.

A console that was killed leaves the file behind. That harms nobody: the address of a console that
does not run answers nothing, and a code is worth nothing there.
"""

from contextlib import suppress
from pathlib import Path
from typing import Final

from rossec import files
from rossec.errors import ConfigurationError

NAME: Final = "console/address"  # in the authority's directory
_MAX: Final = 512
_NONE: Final = ConfigurationError("no console runs", "start it in another terminal: rossec console")


def write_address(directory: Path, origin: str) -> None:
    """Write the console's origin.

    Raises:
        ConfigurationError, NotWritten, PathRefused: it cannot be written.
    """
    path = directory / NAME
    files.make_private_directory(path.parent)
    files.replace(path, origin.encode())


def read_address(directory: Path) -> str:
    """The console's origin.

    Raises:
        ConfigurationError: no console runs.
    """
    return files.read_own(directory / NAME, _MAX, _NONE).decode(errors="replace")


def remove_address(directory: Path) -> None:
    """Remove it: the console ended."""
    with suppress(OSError):
        (directory / NAME).unlink()
