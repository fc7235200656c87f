"""Token revocation list (TRL) queries of RFC 9770: full query, diff query, with a cursor. Pure.

Each requester has a numbered series of updates of *its* part of the TRL; the answer is that part,
or the updates after a cursor. An update is recorded when the requester queries and its part has
changed since, so nothing is stored for peers that never query. The first number is taken from the
start time of the master, so a cursor from an earlier run is recognized as too old.

The answer is information, not proof: nodes rely on the list signed by the authority.
"""

from collections import OrderedDict, deque
from typing import Final, NamedTuple

from ca.encoding import Value, decode, encode
from ca.errors import EncodingError
from rossec.errors import QueryRefused

MAX_N: Final = 64  # updates stored for one requester
MAX_DIFF_BATCH: Final = 16  # updates in one answer
MAX_HASHES: Final = 4096  # token hashes in one answer, unless one update alone has more
MAX_REQUESTERS: Final = 1024
MAX_QUERY: Final = 64  # bytes

# Parameters of the answer, RFC 9770 section 14.1.
_FULL_SET, _DIFF_SET, _CURSOR, _MORE = 0, 1, 2, 3


class TrlUpdate(NamedTuple):
    """One change of a requester's list."""

    number: int
    removed: tuple[bytes, ...]
    added: tuple[bytes, ...]


class Query(NamedTuple):
    """A query; without `diff` a full query."""

    diff: int | None = None
    cursor: int | None = None


class Series:
    """The updates of one requester's list."""

    def __init__(self, first: int, entries: frozenset[bytes]) -> None:
        self._next = first
        self._entries = entries
        self._updates: deque[TrlUpdate] = deque(maxlen=MAX_N)

    def note(self, entries: frozenset[bytes]) -> None:
        """Record that the part of this requester is now `entries`."""
        if entries == self._entries:
            return
        removed, added = sorted(self._entries - entries), sorted(entries - self._entries)
        self._updates.append(TrlUpdate(self._next, tuple(removed), tuple(added)))
        self._entries = entries
        self._next += 1

    def answer(self, query: Query) -> dict[int | str, Value]:
        """The answer to a query.

        Raises:
            QueryRefused: a cursor that was never sent.
        """
        last = self._updates[-1].number if self._updates else None
        if query.diff is None:
            return {_FULL_SET: [*sorted(self._entries)], _CURSOR: last}
        if query.cursor is None:
            wanted = list(self._updates)[-min(query.diff or MAX_N, MAX_N) :]
        elif last is None or query.cursor < self._updates[0].number - 1:
            # The cursor is too old: `more` tells the requester to send a full query.
            return {_DIFF_SET: [], _CURSOR: None, _MORE: last is not None}
        elif query.cursor > last:
            raise QueryRefused("a cursor that was never sent (2)")
        else:
            wanted = [update for update in self._updates if update.number > query.cursor]
            wanted = wanted[: query.diff or MAX_N]
        batch = _batch(wanted)
        cursor = batch[-1].number if batch else last
        diffs: list[Value] = [[[*item.removed], [*item.added]] for item in reversed(batch)]
        return {_DIFF_SET: diffs, _CURSOR: cursor, _MORE: len(batch) < len(wanted)}


class RevocationQueries:
    """The series of all requesters; the least recently used one is discarded.

    Args:
        start: when the master was started, seconds since the epoch.
    """

    def __init__(self, start: int) -> None:
        self._first = start << 20  # reached by a later run only after a million updates a second
        self._series: OrderedDict[bytes, Series] = OrderedDict()

    def answer(self, requester: bytes, entries: frozenset[bytes], query: bytes) -> bytes:
        """Answer one query of the requester whose part of the TRL is `entries`.

        Raises:
            QueryRefused: the query is malformed, or its cursor is invalid.
        """
        parsed = read(query)
        series = self._series.get(requester)
        if series is None:
            series = self._series[requester] = Series(self._first, entries)
            if len(self._series) > MAX_REQUESTERS:
                self._series.popitem(last=False)
        self._series.move_to_end(requester)
        series.note(entries)
        return encode(series.answer(parsed))


def read(query: bytes) -> Query:
    """Read a query: the map {? "diff": uint, ? "cursor": uint}; a cursor needs diff.

    Raises:
        QueryRefused: it is malformed; the number at the end is RFC 9770's error code.
    """
    try:
        value = decode(query, limit=MAX_QUERY)
    except EncodingError as error:
        raise QueryRefused(f"not a query: {error} (0)") from None
    if not isinstance(value, dict) or value.keys() - {"diff", "cursor"}:
        raise QueryRefused("a query is a map of diff and cursor (1)")
    if any(type(number) is not int or number < 0 for number in value.values()):
        raise QueryRefused("diff and cursor are non-negative integers (0)")
    if "cursor" in value and "diff" not in value:
        raise QueryRefused("a cursor without diff (1)")
    return Query(**value)  # type: ignore[arg-type]


def _batch(updates: list[TrlUpdate]) -> list[TrlUpdate]:
    """The oldest updates that fit into one answer."""
    batch: list[TrlUpdate] = []
    hashes = 0
    for update in updates[:MAX_DIFF_BATCH]:
        hashes += len(update.removed) + len(update.added)
        if batch and hashes > MAX_HASHES:
            break
        batch.append(update)
    return batch
