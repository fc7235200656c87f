"""Where the console of an authority is: written when it begins, for the commands that show codes.

There is one at a time: phones belong to one address, and codes lead to it.

A console that was killed leaves the file behind. That harms nobody: the address of a console that
does not run answers nothing, and a code is worth nothing there.
"""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from rossec import files
from rossec.authority.console.messages import ADDRESS, LOCK
from rossec.errors import ConfigurationError
from rossec.operation.process_lock import process_lock

NAME: Final = ADDRESS  # in the authority's directory
_LOCK: Final = LOCK
_MAX: Final = 512
_NONE: Final = ConfigurationError("no console runs", "start it in another terminal: rossec console")


@contextmanager
def only_console(directory: Path) -> Iterator[None]:
    """Be the console of this authority; its address is removed in the end.

    Raises:
        ConfigurationError: another one runs.
    """
    (directory / _LOCK).parent.mkdir(mode=0o700, exist_ok=True)
    busy = ConfigurationError(
        "another console of this authority runs",
        "end that one; to show the pages only: --read-only, and another --port",
    )
    with process_lock(directory / _LOCK, busy):
        try:
            yield
        finally:
            with suppress(OSError):
                (directory / NAME).unlink()


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
