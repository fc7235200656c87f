"""One process at a time: an advisory lock on a file, which ends with the process."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rossec import files
from rossec.errors import ConfigurationError


@contextmanager
def process_lock(path: Path, busy: ConfigurationError) -> Iterator[None]:
    """Hold the lock file `path`.

    Raises:
        ConfigurationError: `busy`, when another process holds it.
    """
    descriptor = files.lock_file(path, busy)
    try:
        yield
    finally:
        os.close(descriptor)
