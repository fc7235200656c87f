"""Commands over several names or files: one that is refused does not stop the others.

Each refusal is printed with its name, the others are done, and the exit code is 1. With `--json`
each has an entry in `results`. An unusable record ends the whole command.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from ca.errors import HintedError, RecordUnusable
from rossec.cli.shared.results import add_entry, recorded_in
from rossec.errors import ConfigurationError
from rossec.terminal import fail


class Batch:
    """The results of `total` names; with a single one its refusal is raised as it is.

    Args:
        total: how many there are.
        key: what they are called in the document: `file`, `name`, `id`.
    """

    def __init__(self, total: int, key: str = "file") -> None:
        self._total = total
        self._key = key
        self._entries: dict[str, dict[str, Any]] = {}
        self._failed = 0

    @property
    def done(self) -> bool:
        """Whether at least one was not refused."""
        return self._failed < self._total

    @contextmanager
    def item(self, label: object, *, last: bool = True) -> Iterator[None]:
        """The work on one of them; `last`: it is done then, and not only checked.

        Raises:
            RecordUnusable: every other one would fail as well.
            HintedError: it was refused, and there is no other.
        """
        entry = self._entry(str(label))
        try:
            with recorded_in(entry):
                yield
        except HintedError as error:
            entry.update(error=str(error), hint=error.hint)
            if self._total == 1 or isinstance(error, RecordUnusable):
                raise
            self._failed += 1
            fail(f"{label}: {error}", error.hint)
        else:
            entry["ok"] = last

    def finish(self) -> None:
        """Return if all went well.

        Raises:
            ConfigurationError: some were refused.
        """
        if self._failed:
            raise ConfigurationError(f"{self._failed} of {self._total} were refused", "see above")

    def _entry(self, label: str) -> dict[str, Any]:
        if label not in self._entries:
            self._entries[label] = {self._key: label, "ok": False}
            add_entry("results", self._entries[label])
        return self._entries[label]


def unique(names: Sequence[str]) -> tuple[str, ...]:
    """Each name once, in order: who names one twice means it once."""
    return tuple(dict.fromkeys(names))
