"""The complain log: one line for every right that somebody lacked, to learn a policy from.

A shell. `rossec policy learn --from-log` reads it: callers of services and readers of parameters do
not show in the graph. Each line is written once, and their number is bounded: an enrolled node
chooses the names, and must not fill the disk with them.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Final, TypeAlias

from grants.model import Right

MAX_LINES: Final = 10_000

Complain: TypeAlias = Callable[[int, str, Right, str], None]
"""Called with `now`, the node, the right it lacks, and the name."""


def unheard(now: int, node: str, right: Right, name: str) -> None:
    """No log is kept."""


class ComplainLog:
    """Appends to the file `path`, which is made for its owner alone."""

    def __init__(self, path: Path) -> None:
        # Only here: learning a policy takes its reader, which a master without this log need not.
        from grants.policy.learn import log_line  # noqa: PLC0415 - a master without complaints need not carry it

        self._line = log_line
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        self._file = os.fdopen(os.open(path, flags, 0o600), "a", encoding="utf-8")
        self._seen: set[tuple[str, Right, str]] = set()

    def __call__(self, now: int, node: str, right: Right, name: str) -> None:
        """Write one line, unless it was written since the start or the log is full."""
        complaint = node, right, name
        if complaint in self._seen or len(self._seen) >= MAX_LINES:
            return
        self._seen.add(complaint)
        self._file.write(self._line(now, node, right, name) + "\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()
