"""How many lines of the log nodes can cause. Pure but for the clock it is given.

Whoever is denied a thousand times a second must fill neither the disk nor the audit, and must not
drown what others do: lines are counted for each node, and for all. Some nodes together could use up
what all have, so each also has a little that is its own. What an administrator does is never left
out; so what nodes cause at will has a logger of its own, below that of the audit. How many lines of
a node were left out stands in the next one of it that is not.
"""

import logging
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from rossec.master.operation.audit import LEFT_OUT

DENIALS: Final = "rossec.audit.denials"
MOST_NODES: Final = 4096


@dataclass
class LineBucket:
    """Room for `burst` lines, filled again at `rate` a second."""

    burst: float
    rate: float
    tokens: float
    at: float

    @classmethod
    def full(cls, burst: float, rate: float, now: float) -> "LineBucket":
        """One that nothing was taken from."""
        return cls(burst, rate, burst, now)

    def refill(self, now: float) -> bool:
        """Whether there is room for a line now."""
        self.tokens = min(self.burst, self.tokens + max(0.0, now - self.at) * self.rate)
        self.at = now
        return self.tokens >= 1


@dataclass
class NodeBudget:
    """What one node may cause, what of it does not depend on others, and what it did in vain."""

    limit: LineBucket
    reserved: LineBucket
    left_out: int = 0


class DenialRateLimit(logging.Filter):
    """Lets a line through while its node, the first argument of the line, and all have room."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._common = LineBucket.full(1000, 50, clock())
        self._nodes: OrderedDict[str, NodeBudget] = OrderedDict()

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the line is written; it says then how many before it were not."""
        now = self._clock()
        args = record.args
        budget = self._budget(str(args[0]) if isinstance(args, tuple) and args else "", now)
        common = self._common if self._common.refill(now) else budget.reserved
        if not (budget.limit.refill(now) and common.refill(now)):
            budget.left_out += 1
            return False
        budget.limit.tokens -= 1
        common.tokens -= 1
        if budget.left_out:
            setattr(record, LEFT_OUT, budget.left_out)
            budget.left_out = 0
        return True

    def _budget(self, node: str, now: float) -> NodeBudget:
        budget = self._nodes.get(node)
        if budget is None:
            limit, reserved = LineBucket.full(200, 10, now), LineBucket.full(10, 0.1, now)
            budget = self._nodes[node] = NodeBudget(limit, reserved)
            if len(self._nodes) > MOST_NODES:
                self._nodes.popitem(last=False)
        self._nodes.move_to_end(node)
        return budget
