"""Commands over several files: one refused file does not stop the others.

Each refusal is printed with its file, the other files are processed, and the exit code is 1. An
unusable record ends the whole command.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ca.errors import HintedError, RecordUnusable
from rossec.errors import ConfigurationError
from rossec.terminal import fail


class Batch:
    """The results of `total` files; with a single file its refusal is raised as it is."""

    def __init__(self, total: int) -> None:
        self._total = total
        self._failed = 0

    @contextmanager
    def item(self, path: Path) -> Iterator[None]:
        """The work on one file.

        Raises:
            RecordUnusable: every other file would fail as well.
            HintedError: the file was refused, and there is no other.
        """
        try:
            yield
        except RecordUnusable:
            raise
        except HintedError as error:
            if self._total == 1:
                raise
            self._failed += 1
            fail(f"{path}: {error}", error.hint)

    def finish(self) -> None:
        """Return if all went well.

        Raises:
            ConfigurationError: some were refused.
        """
        if self._failed:
            raise ConfigurationError(f"{self._failed} of {self._total} were refused", "see above")
