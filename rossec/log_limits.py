"""The same line again and again tells nobody more: programs try again, and so are refused again.

Nor do hundreds of different ones in a minute, which a peer may cause; errors of ours are said. Who
is spoken of, the first argument of a line, has a share: nobody silences what is said of others.
A line that is said again tells how often it was left out.
"""

import logging
from collections import Counter, OrderedDict
from typing import Final

_PERIOD: Final = 60.0
_REMEMBERED: Final = 512
_SHARE: Final = 64
_FIRST: Final = 1024  # beyond what is remembered, the first of each is said
CAUSE: Final = "rossec_cause"  # of a record: what counts instead of its text, and whom it is about


class LogRateLimit(logging.Filter):
    """Lets the same text through once a minute, and so many texts about one and about all."""

    def __init__(self) -> None:
        super().__init__()
        self._said: dict[str, tuple[float, str]] = {}  # the oldest first
        self._about: Counter[str] = Counter()
        self._left_out: OrderedDict[str, int] = OrderedDict()  # of what was said at some time

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to say it; the time is the record's own."""
        line, about = getattr(record, CAUSE, None) or (record.getMessage(), subject(record))
        self._forget_before(record.created - _PERIOD)
        if line in self._said:
            self._leave_out(line)
            return False
        most = _REMEMBERED if self._about[about] else _FIRST
        if self._about[about] >= _SHARE or len(self._said) >= most:
            return record.levelno >= logging.ERROR
        self._said[line] = record.created, about
        self._about[about] += 1
        self._add_up(line, record)
        return True

    def _leave_out(self, line: str) -> None:
        self._left_out[line] = self._left_out.pop(line, 0) + 1
        if len(self._left_out) > _FIRST:
            self._left_out.popitem(last=False)

    def _add_up(self, line: str, record: logging.LogRecord) -> None:
        count = self._left_out.pop(line, 0)
        if count:
            record.msg = f"{record.getMessage()} ({count} more like this since it was said last)"
            record.args = None

    def _forget_before(self, time: float) -> None:
        while self._said:
            line, (said, about) = next(iter(self._said.items()))
            if said > time:
                break
            del self._said[line]
            self._about -= Counter([about])  # which keeps no zeros


def subject(record: logging.LogRecord) -> str:
    """Whom a line is about, as lines of ours have it: their first argument."""
    return str(record.args[0]) if isinstance(record.args, tuple) and record.args else ""
