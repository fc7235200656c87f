"""The grant request store: requests for grants in the authority's record, and their answers.

Its two tables are append-only like the others: an answer is a new row. Requests arrive as files:
given by the operator, or written to the inbox by a node of the same ROSSEC_HOME.
"""

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NamedTuple

from ca.errors import RecordUnusable, StoreError
from ca.store.database import Database, append_entry
from ca.store.values import digest_of
from grants.model import Right
from grants.request import GrantRequest, RequestedRight, peek_request
from rossec import files

MAX_FILE: Final = 16 * 1024
OWNED: Final = (files.Owned(r"inbox/[^/]{1,120}\.request"),)
MAX_INBOX: Final = 256  # files read at once


class StoredRequest(NamedTuple):
    request: GrantRequest
    at: int
    requested: RequestedRight

    @property
    def short_id(self) -> str:
        return self.request.id.hex()[:8]


class GrantRequestStore:
    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, request: GrantRequest, data: bytes, now: int) -> None:
        with self._transaction() as db:
            row = (request.id, request.node, data, now)
            db.execute("INSERT INTO grant_request VALUES (?, ?, ?, ?)", row)
            append_entry(db, now, "grant request", request.node, request.id.hex(), digest_of(row))

    def answer(self, stored: StoredRequest, answer: str, reason: str, now: int) -> None:
        with self._transaction() as db:
            requested = stored.requested
            row = (stored.request.id, int(requested.right), requested.pattern, answer, reason, now)
            db.execute("INSERT INTO decision VALUES (?, ?, ?, ?, ?, ?)", row)
            detail = f"{answer} {requested.pattern}"
            append_entry(db, now, "decision", stored.request.node, detail, digest_of(row))

    def _all(self) -> list[StoredRequest]:
        rows = self._database.rows("SELECT data, at FROM grant_request ORDER BY rowid")
        requests = [(peek_request(data), at) for data, at in rows]
        return [StoredRequest(found, at, requested) for found, at in requests for requested in found.rights]

    def unanswered(self) -> list[StoredRequest]:
        answered = set(self._database.rows("SELECT request, right, pattern FROM decision"))
        return [
            each
            for each in self._all()
            if (each.request.id, int(each.requested.right), each.requested.pattern) not in answered
        ]

    def answers(self) -> list[tuple[StoredRequest, str, str, int]]:
        """Each right that was answered, oldest first, with the answer, its reason and when."""
        requests = {each.request.id: each for each in self._all()}
        sql = "SELECT request, right, pattern, answer, reason, at FROM decision ORDER BY rowid"
        found = []
        for number, right, pattern, *answer in self._database.rows(sql):
            if number in requests:
                requested = RequestedRight(Right(right), pattern)
                found.append((requests[number]._replace(requested=requested), *answer))
        return found

    def find(self, number: bytes) -> list[StoredRequest]:
        """Every right of the request with this id, answered or not; none: there is no such one."""
        return [each for each in self._all() if each.request.id == number]

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        try:
            with self._database.transaction() as db:
                yield db
        except RecordUnusable:
            raise
        except StoreError as error:
            raise StoreError(
                "the request is already recorded or answered", "see: rossec grant pending"
            ) from error


def put_in_inbox(authority: Path, request: GrantRequest, data: bytes) -> Path:
    files.make_private_directory(authority / "inbox")
    path = authority / "inbox" / f"{request.id.hex()}.request"
    files.replace(path, data)
    return path


def inbox_files(authority: Path) -> list[Path]:
    # So many at once: whoever fills the inbox does not keep the record locked for long.
    return sorted((authority / "inbox").glob("*.request"))[:MAX_INBOX]


def read_request(path: Path) -> bytes:
    return files.read(path, MAX_FILE)
