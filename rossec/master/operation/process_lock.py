"""One master at a time runs from a directory: an advisory lock, which ends with the process."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from rossec import files
from rossec.errors import ConfigurationError

FILE_NAME: Final = "master.lock"


@contextmanager
def process_lock(directory: Path) -> Iterator[None]:
    """Hold the lock of the master in `directory`.

    Raises:
        ConfigurationError: another master holds it.
    """
    busy = ConfigurationError(
        f"another master runs from {directory}",
        "end it first; two would lose each other's parameters",
    )
    descriptor = files.lock_file(directory / FILE_NAME, busy)
    try:
        yield
    finally:
        os.close(descriptor)
