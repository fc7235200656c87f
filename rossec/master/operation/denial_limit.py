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
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Final

from grants.token_bucket import TokenBucket
from rossec.log_limits import subject
from rossec.operation.audit import LEFT_OUT

DENIALS: Final = "rossec.audit.denials"
MAX_NODES: Final = 4096


@dataclass
class NodeBudget:
    """The limit of one node, its reserve, and the number of lines left out."""

    limit: TokenBucket = field(default_factory=lambda: TokenBucket(10, 200))
    reserved: TokenBucket = field(default_factory=lambda: TokenBucket(0.1, 10))
    left_out: int = 0


class DenialRateLimit(logging.Filter):
    """Passes a line while the buckets of its node (its first argument) and of all have tokens."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._common = TokenBucket(50, 1000)
        self._nodes: OrderedDict[str, NodeBudget] = OrderedDict()

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the line is written; if so, it records how many before it were not."""
        now = self._clock()
        budget = self._budget(subject(record))
        common = self._common if self._common.refill(now) >= 1 else budget.reserved
        if not (budget.limit.refill(now) >= 1 and common.refill(now) >= 1):
            budget.left_out += 1
            return False
        budget.limit.tokens -= 1
        common.tokens -= 1
        if budget.left_out:
            setattr(record, LEFT_OUT, budget.left_out)
            budget.left_out = 0
        return True

    def _budget(self, node: str) -> NodeBudget:
        budget = self._nodes.pop(node, None) or NodeBudget()
        self._nodes[node] = budget
        if len(self._nodes) > MAX_NODES:
            self._nodes.popitem(last=False)
        return budget


@contextmanager
def denials_limited() -> Iterator[None]:
    """Limit the rate of the lines that nodes cause."""
    limit, log = DenialRateLimit(), logging.getLogger(DENIALS)
    log.addFilter(limit)
    try:
        yield
    finally:
        log.removeFilter(limit)
