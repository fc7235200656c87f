"""How many lines of the log nodes can cause. Pure but for the clock it is given.

Whoever is denied a thousand times a second must fill neither the disk nor the audit, and must not
drown what others do: lines are counted for each node, and for all. What an administrator does is
never left out; so what nodes cause at will has a logger of its own, below that of the audit. How
many lines of a node were left out stands in the next one of it that is not.
"""

import logging
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from rossec.master.audit import LEFT_OUT

DENIALS: Final = "rossec.audit.denials"
MOST_NODES: Final = 4096


@dataclass
class Bucket:
    """Room for `burst` lines, filled again at `rate` a second."""

    burst: float
    rate: float
    room: float
    at: float
    left_out: int = 0

    def fill(self, now: float) -> bool:
        """Whether there is room for a line now."""
        self.room = min(self.burst, self.room + max(0.0, now - self.at) * self.rate)
        self.at = now
        return self.room >= 1


class Throttle(logging.Filter):
    """Lets a line through while its node, the first argument of the line, and all have room."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._all = Bucket(1000, 50, 1000, clock())
        self._nodes: OrderedDict[str, Bucket] = OrderedDict()

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the line is written; it says then how many before it were not."""
        now = self._clock()
        bucket = self._of(
            str(record.args[0]) if record.args and isinstance(record.args, tuple) else "", now
        )
        if not (bucket.fill(now) and self._all.fill(now)):
            bucket.left_out += 1
            return False
        bucket.room -= 1
        self._all.room -= 1
        if bucket.left_out:
            setattr(record, LEFT_OUT, bucket.left_out)
            bucket.left_out = 0
        return True

    def _of(self, node: str, now: float) -> Bucket:
        bucket = self._nodes.get(node)
        if bucket is None:
            bucket = self._nodes[node] = Bucket(200, 10, 200, now)
            if len(self._nodes) > MOST_NODES:
                self._nodes.popitem(last=False)
        self._nodes.move_to_end(node)
        return bucket


def _node_of(record: logging.LogRecord) -> str:
    return str(record.args[0]) if isinstance(record.args, tuple) and record.args else ""
