"""The complain log: one line for every right that somebody lacked, to learn a policy from.

A shell. `rossec policy learn --from-log` reads it: callers of services and readers of parameters do
not show in the graph. Each line is written once, and their number is bounded: an enrolled node
chooses the names, and must not fill the disk with them. Each node has a share that no other can
use up, or one of them would decide what is learnt of the others.
"""

import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Final, TypeAlias

from grants.model import Right
from rossec import files

LINES_PER_NODE: Final = 200  # lines of one node
MAX_LINES: Final = 10_000  # of all nodes beyond their shares

OnDenial: TypeAlias = Callable[[int, str, Right, str], None]
"""Called with `now`, the node, the right it lacks, and the name."""


def ignore_denial(now: int, node: str, right: Right, name: str) -> None:
    """No log is kept."""


class DenialLog:
    """Appends to the file `path`, which is made for its owner alone.

    Raises:
        PathRefused: somebody else made it, as anybody can in a directory such as /tmp.
    """

    def __init__(self, path: Path) -> None:
        # Only here: learning a policy takes its reader, which a master without this log need not.
        from grants.policy.learn import log_line  # noqa: PLC0415 - a master without complaints need not carry it

        self._line = log_line
        self._file = os.fdopen(files.append_own(path), "a", encoding="utf-8")
        self._seen: set[tuple[str, Right, str]] = set()
        self._lines_of_node: Counter[str] = Counter()
        self._lines_beyond = 0

    def __call__(self, now: int, node: str, right: Right, name: str) -> None:
        """Write one line, unless it was written since the start, or node and log are full."""
        denial = node, right, name
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
