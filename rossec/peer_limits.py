"""Limits on what peers may cause: text in logs, messages that never end, tables, lines of a log. Pure."""

import logging
import unicodedata
from collections import Counter
from collections.abc import Callable
from typing import Final, Generic, NamedTuple, TypeVar

from ca.bounded import Newest
from rossec.errors import LimitExceeded

TEXT_LIMIT: Final = 1000
_CUT: Final = "..."
_HARMFUL: Final = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})


STEP: Final = 5  # seconds until the next check
WINDOW: Final = 60
MIN_BYTES: Final = 256 * 1024  # 35 kbit/s
MAX_SECONDS: Final = 600
_PERIOD: Final = 60.0
_MAX_LINES: Final = 512
# A share for each: one peer cannot keep the lines about others away (0012).
_PER_SUBJECT: Final = 64
_MAX_FIRST_LINES: Final = 1024  # beyond that limit, the first line of each subject is logged
CAUSE: Final = "rossec_cause"  # of a record: the text and the subject to count by


def printable(text: object, limit: int = TEXT_LIMIT) -> str:
    """One bounded line: control, direction and line characters are escaped, the rest is cut off.

    A line break in a text of a peer would forge log lines.
    """
    whole = str(text)
    shown = "".join(map(_shown, whole[:limit]))
    return shown if len(whole) <= limit else shown + _CUT


def _shown(char: str) -> str:
    if unicodedata.category(char) not in _HARMFUL:
        return char
    return f"\\u{ord(char):04x}" if ord(char) <= 0xFFFF else f"\\U{ord(char):08x}"


class Progress:
    """The progress of one message after the other: it may be slow, but must make progress.

    An incomplete message is kept in memory: a peer that may send much could have it held for ever.
    So it has to grow by `MIN_BYTES` in each `WINDOW` seconds, and to be complete after
    `MAX_SECONDS`. Only time in which this side reads counts: between two checks never more than
    `STEP`, however long the reader was busy, and even if the clock is set.
    """

    __slots__ = ("_age", "_at", "_mark_age", "_mark_length")

    def __init__(self) -> None:
        self._at: int | None = None
        self._age = self._mark_age = self._mark_length = 0

    @property
    def deadline(self) -> int | None:
        return None if self._at is None else self._at + STEP

    def done(self) -> None:
        self._at = None

    def check(self, now: int, length: int, *, reading: bool = True) -> None:
        """The message has `length` bytes at `now` (seconds)."""
        if self._at is None:
            self._age = self._mark_age = self._mark_length = 0
        elif reading:
            self._age += min(max(0, now - self._at), STEP)
        self._at = now
        if length - self._mark_length >= MIN_BYTES:
            self._mark_age, self._mark_length = self._age, length
        if self._age - self._mark_age >= WINDOW or self._age >= MAX_SECONDS:
            raise LimitExceeded(
                f"a message is not whole after {self._age} seconds, with {length} bytes of it",
                f"a message must arrive within {MAX_SECONDS} s, {MIN_BYTES // 1024} KiB of it a minute",
            )


K = TypeVar("K")
V = TypeVar("V")


class _Entry(NamedTuple, Generic[V]):
    value: V
    owner: str
    rank: int


class SharedTable(Generic[K, V]):
    """At most `limit` values by their keys, each of an owner.

    Where it is full, whoever has most makes room, with the oldest that is theirs; of those with the
    lowest rank first, and never of a higher rank than the newcomer's. So a table that ends its
    oldest entry cannot be used to end another's, and what a stranger begins ends nothing that an
    owner began.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._entries: dict[K, _Entry[V]] = {}  # oldest first

    def __repr__(self) -> str:
        return f"SharedTable({self._entries!r})"

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, key: K, value: V, owner: str, rank: int = 0) -> list[V] | None:
        """Put a value in; returns those that made room. None: there is no room for `owner`."""
        self._entries.pop(key, None)
        ended: list[V] = []
        while len(self._entries) >= self._limit:
            victim = self._victim(owner, rank)
            if victim is None:
                return None
            ended.append(self._entries.pop(victim).value)
        self._entries[key] = _Entry(value, owner, rank)
        return ended

    def get(self, key: K) -> V | None:
        found = self._entries.get(key)
        return None if found is None else found.value

    def pop(self, key: K) -> V | None:
        found = self._entries.pop(key, None)
        return None if found is None else found.value

    def owner(self, key: K) -> tuple[str, int] | None:
        found = self._entries.get(key)
        return None if found is None else (found.owner, found.rank)

    def drop(self, is_over: Callable[[V], bool]) -> None:
        for key in [key for key, entry in self._entries.items() if is_over(entry.value)]:
            del self._entries[key]

    def items(self) -> list[tuple[K, V]]:
        return [(key, entry.value) for key, entry in self._entries.items()]

    def _victim(self, owner: str, rank: int) -> K | None:
        lowest = min(entry.rank for entry in self._entries.values())
        if lowest > rank:
            return None
        of_rank = [entry.owner for entry in self._entries.values() if entry.rank == lowest]
        counts = Counter(of_rank)
        most = max(counts, key=counts.__getitem__)
        if lowest == rank and counts[most] <= counts[owner] + 1:
            most = owner  # who has a share like everybody's makes room for themselves
        return next(
            (key for key, entry in self._entries.items() if entry.owner == most and entry.rank == lowest),
            None,
        )


class LogRateLimit(logging.Filter):
    """A rate limit of log lines: programs retry, and the same refusal would fill the log.

    The same line is logged once a minute, and a limited number of different ones, since a peer may
    cause hundreds; errors are always logged. Each subject, the first argument of a line, has its own
    limit: one peer cannot suppress the lines about others. A repeated line has the count of those
    left out.
    """

    def __init__(self) -> None:
        super().__init__()
        self._logged: dict[str, tuple[float, str]] = {}  # the oldest first
        self._subjects: Counter[str] = Counter()
        self._left_out: Newest[str, int] = Newest(_MAX_FIRST_LINES)  # of lines that were logged before

    def filter(self, record: logging.LogRecord) -> bool:
        line, about = getattr(record, CAUSE, None) or (record.getMessage(), subject(record))
        while self._logged:
            oldest, (said, cause) = next(iter(self._logged.items()))
            if said > record.created - _PERIOD:
                break
            del self._logged[oldest]
            self._subjects -= Counter([cause])  # drops zero counts
        if line in self._logged:
            self._left_out[line] = self._left_out.get(line, 0) + 1
            return False
        most = _MAX_LINES if self._subjects[about] else _MAX_FIRST_LINES
        if self._subjects[about] >= _PER_SUBJECT or len(self._logged) >= most:
            return record.levelno >= logging.ERROR
        self._logged[line] = record.created, about
        self._subjects[about] += 1
        count = self._left_out.pop(line, 0)
        if count:
            record.msg = f"{record.getMessage()} ({count} more like this since it was logged last)"
            record.args = None
        return True


def subject(record: logging.LogRecord) -> str:
    return str(record.args[0]) if isinstance(record.args, tuple) and record.args else ""
