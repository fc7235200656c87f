"""A rate limit of log lines: programs retry, and the same refusal would fill the log.

The same line is logged once a minute, and a limited number of different ones, since a peer may
cause hundreds; errors are always logged. Each subject, the first argument of a line, has its own
limit: one peer cannot suppress the lines about others. A repeated line has the count of those
left out.
"""

import logging
from collections import Counter, OrderedDict
from typing import Final

_PERIOD: Final = 60.0
_MAX_LINES: Final = 512
_PER_SUBJECT: Final = 64
_MAX_FIRST_LINES: Final = 1024  # beyond that limit, the first line of each subject is logged
CAUSE: Final = "rossec_cause"  # of a record: the text and the subject to count by


class LogRateLimit(logging.Filter):
    """Lets a text through once a minute, and so many texts for one subject and for all."""

    def __init__(self) -> None:
        super().__init__()
        self._logged: dict[str, tuple[float, str]] = {}  # the oldest first
        self._subjects: Counter[str] = Counter()
        self._left_out: OrderedDict[str, int] = OrderedDict()  # of lines that were logged before

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to log it; the time is the record's own."""
        line, about = getattr(record, CAUSE, None) or (record.getMessage(), subject(record))
        self._forget_before(record.created - _PERIOD)
        if line in self._logged:
            self._leave_out(line)
            return False
        most = _MAX_LINES if self._subjects[about] else _MAX_FIRST_LINES
        if self._subjects[about] >= _PER_SUBJECT or len(self._logged) >= most:
            return record.levelno >= logging.ERROR
        self._logged[line] = record.created, about
        self._subjects[about] += 1
        self._add_up(line, record)
        return True

    def _leave_out(self, line: str) -> None:
        self._left_out[line] = self._left_out.pop(line, 0) + 1
        if len(self._left_out) > _MAX_FIRST_LINES:
            self._left_out.popitem(last=False)

    def _add_up(self, line: str, record: logging.LogRecord) -> None:
        count = self._left_out.pop(line, 0)
        if count:
            record.msg = f"{record.getMessage()} ({count} more like this since it was logged last)"
            record.args = None

    def _forget_before(self, time: float) -> None:
        while self._logged:
            line, (said, about) = next(iter(self._logged.items()))
            if said > time:
                break
            del self._logged[line]
            self._subjects -= Counter([about])  # drops zero counts


def subject(record: logging.LogRecord) -> str:
    """The subject of a line: by convention its first argument."""
    return str(record.args[0]) if isinstance(record.args, tuple) and record.args else ""
