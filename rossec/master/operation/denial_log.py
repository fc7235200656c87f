"""The denial log: one line for every right that a caller lacked, to learn a policy from.

A shell. `rossec policy learn --from-log` reads it: callers of services and readers of parameters do
not appear in the graph. Each line is written once, and their number is limited: an enrolled node
chooses the names, and must not fill the disk with them. Each node has a quota that no other can
use up, else one of them could keep the others out of the log.
"""

import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Final, TypeAlias

from grants.basics import own_form
from grants.model import Right
from rossec import files

LINES_PER_NODE: Final = 200  # lines of one node
MAX_LINES: Final = 10_000  # of all nodes beyond their quotas

OnDenial: TypeAlias = Callable[[int, str, Right, str], None]
"""Called with `now`, the node, the right it lacks, and the name."""


def ignore_denial(now: int, node: str, right: Right, name: str) -> None:
    """Log nothing."""


class DenialLog:
    """Appends to the file `path`, which is created for its owner alone.

    Raises:
        PathRefused: another user owns it, as is possible in a directory such as /tmp.
    """

    def __init__(self, path: Path) -> None:
        from grants.policy.learn import log_line  # noqa: PLC0415 - not loaded without this log

        self._line = log_line
        self._file = os.fdopen(files.append_own(path), "a", encoding="utf-8")
        self._seen: set[tuple[str, Right, str]] = set()
        self._lines_of_node: Counter[str] = Counter()
        self._lines_beyond = 0

    def __call__(self, now: int, node: str, right: Right, name: str) -> None:
        """Write one line, unless it was written since the start or the limits are reached."""
        denial = node, right, own_form(node, name)  # one run of an anonymous node is as the next
        is_beyond = self._lines_of_node[node] >= LINES_PER_NODE
        if denial in self._seen or (is_beyond and self._lines_beyond >= MAX_LINES):
            return
        self._seen.add(denial)
        self._lines_of_node[node] += 1
        self._lines_beyond += is_beyond
        self._file.write(self._line(now, node, right, name) + "\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()
