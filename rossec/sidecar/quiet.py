"""The same line again and again tells nobody more: programs try again, and so are refused again.

Nor do hundreds of different ones in a minute, which a peer may cause; errors of ours are said.
"""

import logging
from typing import Final

_PERIOD: Final = 60.0
_REMEMBERED: Final = 512


class Quiet(logging.Filter):
    """Lets the same text through once a minute, and so many texts."""

    def __init__(self) -> None:
        super().__init__()
        self._said: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to say it; the time is the record's own."""
        line = record.getMessage()
        if record.created - self._said.get(line, -_PERIOD) < _PERIOD:
            return False
        self._said.pop(line, None)
        if len(self._said) >= _REMEMBERED:
            oldest = next(iter(self._said))
            if record.created - self._said[oldest] < _PERIOD:
                return record.levelno >= logging.ERROR
            del self._said[oldest]
        self._said[line] = record.created
        return True
