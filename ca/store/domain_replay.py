"""The audit of foreign domains: replayed from the log, in the order in which they were trusted.

Terms are in form, and no two trusted domains share a name, a label or a root key; an end is of a
domain that is trusted. A list is signed by the authority, newer than the one before, and names only
domains with the terms that the record has at that point: the record cannot be made to deny what a
list said. The rows are those of the log already (`ca.store.log`).
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.domains.lists import verify_domains
from ca.errors import CAError, LogDamaged
from ca.store.domains import DomainRow, check_apart
from ca.store.log_entries import LogEntry

KINDS: Final = ("domain", "domain ended", "domain list")
_HINT: Final = "somebody changed the record: restore a backup, and find out who"
Row = tuple[Any, ...]


def replay_domains(
    entries: Iterable[LogEntry],
    rows: Mapping[str, Iterable[Row]],
    key: ec.EllipticCurvePublicKey,
) -> None:
    """Check every domain and list; `rows` are those of the tables, by kind; `key` is the root's.

    Raises:
        LogDamaged: names the first entry that could not have been made.
    """
    replay = _Replay(rows, key)
    for entry in entries:
        step = replay.steps.get(entry.what)
        if step is not None:
            try:
                step(entry)
            except CAError as error:
                raise LogDamaged(f"log entry {entry.number}: {error}", _HINT) from error


class _Replay:
    def __init__(self, rows: Mapping[str, Iterable[Row]], key: ec.EllipticCurvePublicKey) -> None:
        self._key = key
        self._rows: dict[str, Iterator[Row]] = {kind: iter(rows[kind]) for kind in KINDS}
        self._trusted: dict[str, DomainRow] = {}  # by domain
        self._last = (0, 0)
        self.steps: Mapping[str, Callable[[LogEntry], None]] = {
            "domain": self._accept,
            "domain ended": self._end,
            "domain list": self._list,
        }

    def _accept(self, entry: LogEntry) -> None:
        row = DomainRow(*next(self._rows["domain"]))
        terms = row.read()
        found = terms.domain, terms.label, terms.anchor.thumbprint
        _require(found == (row.domain, row.label, row.root), entry)
        for known in self._trusted.values():
            check_apart(known, *found)
        self._trusted[row.domain] = row

    def _end(self, entry: LogEntry) -> None:
        number = next(self._rows["domain ended"])[0]
        ended = [row for row in self._trusted.values() if row.number == number]
        _require(len(ended) == 1, entry)
        del self._trusted[ended[0].domain]

    def _list(self, entry: LogEntry) -> None:
        epoch, seq, data = next(self._rows["domain list"])
        listed = verify_domains(data, self._key)
        _require(self._last < (epoch, seq) == listed.number, entry)
        self._last = listed.number
        for each in listed.domains:
            known = self._trusted.get(each.domain)
            _require(known is not None and known.terms == each.terms, entry)


def _require(holds: bool, entry: LogEntry) -> None:
    if not holds:
        raise LogDamaged(f"log entry {entry.number} says {entry.what}, which cannot be", _HINT)
