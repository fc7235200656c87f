"""Rate limit for log lines that nodes cause: token buckets. Pure except for the given clock.

A node that is denied a thousand times a second must neither fill the disk nor hide the lines of
others: there is a bucket for each node and one for all. Several nodes together could empty the
common one, so each also has a small bucket in reserve. Lines of administrators are never limited;
so the lines that nodes cause have their own logger, a child of the audit's. The number of lines
that were left out is recorded in the next line of that node.
"""

import logging
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from rossec.master.operation.audit import LEFT_OUT

DENIALS: Final = "rossec.audit.denials"
MAX_NODES: Final = 4096


@dataclass
class LineBucket:
    """A token bucket of `burst` lines, refilled at `rate` a second."""

    burst: float
    rate: float
    tokens: float
    at: float

    @classmethod
    def full(cls, burst: float, rate: float, now: float) -> "LineBucket":
        """A full bucket."""
        return cls(burst, rate, burst, now)

    def refill(self, now: float) -> bool:
        """Refill the bucket; whether it has a token for a line."""
        self.tokens = min(self.burst, self.tokens + max(0.0, now - self.at) * self.rate)
        self.at = now
        return self.tokens >= 1


@dataclass
class NodeBudget:
    """The limit of one node, its reserve, and the number of lines left out."""

    limit: LineBucket
    reserved: LineBucket
    left_out: int = 0


class DenialRateLimit(logging.Filter):
    """Passes a line while the buckets of its node (its first argument) and of all have tokens."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._common = LineBucket.full(1000, 50, clock())
        self._nodes: OrderedDict[str, NodeBudget] = OrderedDict()

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the line is written; if so, it records how many before it were not."""
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
            if len(self._nodes) > MAX_NODES:
                self._nodes.popitem(last=False)
        self._nodes.move_to_end(node)
        return budget
