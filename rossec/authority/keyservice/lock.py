"""One service of an authority at a time, and none while a backup is restored over it."""

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Final

from rossec import files
from rossec.errors import ConfigurationError
from rossec.operation.process_lock import process_lock

LOCK: Final = "service.lock"
OWNED: Final = (files.Owned(r"service\.lock", kept=False),)  # of a process


def service_lock(directory: Path) -> AbstractContextManager[None]:
    """The lock of the service of the authority in `directory`; it ends with the process.

    Raises:
        ConfigurationError: when it is entered, and a service runs.
    """
    busy = ConfigurationError(
        f"the authority's service runs from {directory}",
        "end it first: Ctrl-C where it runs, or systemctl stop rossec-ca",
    )
    return process_lock(directory / LOCK, busy)
