"""Commands over several files: one that is refused does not fail the rest.

It is said which and why, the others are done, and the exit code is that of a refusal. A record that
cannot be used ends all of them.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ca.errors import HintedError, RecordUnusable
from rossec.errors import ConfigurationError
from rossec.terminal import fail


class Batch:
    """What became of `total` files; a single one is refused as it always was."""

    def __init__(self, total: int) -> None:
        self._total = total
        self._failed = 0

    @contextmanager
    def one(self, path: Path) -> Iterator[None]:
        """The work on one file.

        Raises:
            RecordUnusable: no other file would fare better.
            HintedError: what was refused, when there is no other file.
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

    def end(self) -> None:
        """Return if all went well.

        Raises:
            ConfigurationError: how many did not.
        """
        if self._failed:
            raise ConfigurationError(f"{self._failed} of {self._total} were refused", "see above")
