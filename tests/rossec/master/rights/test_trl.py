"""RFC 9770 queries: full, diff, with cursors, and their limits."""

from typing import Any

import pytest

from ca.encoding import Value, decode, encode
from rossec.errors import RossecError
from rossec.master.rights import revocation_lists
from rossec.master.rights.revocation_lists import MAX_DIFF_BATCH, MAX_N, RevocationQueries, read_query

A, B, C = b"a" * 16, b"b" * 16, b"c" * 32
START = 1_800_000_000
FIRST = START << 20


class Requester:
    def __init__(self) -> None:
        self.queries = RevocationQueries(START)
        self.entries: set[bytes] = set()

    def ask(self, **numbers: int) -> Any:
        query: dict[int | str, Value] = dict(numbers.items())
        answer = self.queries.answer(b"me", frozenset(self.entries), encode(query))
        return decode(answer, limit=1 << 20)

    def add(self, *entries: bytes) -> None:
        self.entries.update(entries)
        self.ask()


@pytest.fixture
def requester() -> Requester:
    requester = Requester()
    requester.add()
    return requester


def test_a_full_query(requester: Requester) -> None:
    assert requester.ask() == {0: [], 2: None}
    requester.add(B, A)
    assert requester.ask() == {0: [A, B], 2: FIRST}


def test_a_diff_query_is_newest_first(requester: Requester) -> None:
    assert requester.ask(diff=0) == {1: [], 2: None, 3: False}
    requester.add(A)
    requester.add(B)
    requester.entries.discard(A)
    assert requester.ask(diff=0) == {1: [[[A], []], [[], [B]], [[], [A]]], 2: FIRST + 2, 3: False}
    assert requester.ask(diff=1) == {1: [[[A], []]], 2: FIRST + 2, 3: False}


def test_a_diff_query_from_a_cursor(requester: Requester) -> None:
    requester.add(A)
    cursor = requester.ask()[2]
    assert requester.ask(diff=0, cursor=cursor) == {1: [], 2: cursor, 3: False}
    requester.add(B)
    requester.add(C)
    assert requester.ask(diff=0, cursor=cursor)[1] == [[[], [C]], [[], [B]]]
    assert requester.ask(diff=1, cursor=cursor) == {1: [[[], [B]]], 2: cursor + 1, 3: False}
    with pytest.raises(RossecError, match=r"never sent \(2\)"):
        requester.ask(diff=0, cursor=cursor + 3)


def test_batches_until_there_is_no_more(requester: Requester) -> None:
    for n in range(MAX_DIFF_BATCH + 2):
        requester.add(n.to_bytes(16))
    first = requester.ask(diff=0)
    assert (len(first[1]), first[3]) == (MAX_DIFF_BATCH, True)
    assert first[1][-1] == [[], [bytes(16)]]  # the oldest come first, so that none is missed
    rest = requester.ask(diff=0, cursor=first[2])
    assert (len(rest[1]), rest[3]) == (2, False)


def test_an_answer_is_bounded_in_hashes_too(requester: Requester, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(revocation_lists, "MAX_HASHES", 3)
    for n in range(3):
        requester.add(*(bytes([n, m]) * 8 for m in range(2)))
    assert [len(requester.ask(diff=0)[1]), requester.ask(diff=0)[3]] == [1, True]


def test_a_cursor_too_old_asks_for_a_full_query(requester: Requester) -> None:
    begin: dict[int, Any] = {1: [], 2: None, 3: False}
    assert requester.ask(diff=0, cursor=5) == begin
    for n in range(MAX_N + 2):
        requester.add(n.to_bytes(16))
    for cursor in (0, FIRST, FIRST - 1):  # of an earlier run of the master, and discarded
        assert requester.ask(diff=0, cursor=cursor) == {1: [], 2: None, 3: True}
    assert requester.ask(diff=0, cursor=FIRST + 1)[3]


def test_requesters_have_series_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(revocation_lists, "MAX_REQUESTERS", 2)
    queries = RevocationQueries(START)

    def ask(who: bytes, *entries: bytes) -> Any:
        return decode(queries.answer(who, frozenset(entries), encode({"diff": 0})))

    for who in (b"one", b"two"):
        assert ask(who) == {1: [], 2: None, 3: False}
    assert ask(b"one", A)[2] == FIRST
    assert ask(b"two", B)[1] == [[[], [B]]]
    ask(b"three")
    assert ask(b"one", A) == {1: [], 2: None, 3: False}  # the least recently used requester


@pytest.mark.parametrize(
    ("query", "message"),
    [
        (b"", r"\(0\)"),
        (bytes(100), r"\(0\)"),
        (encode([]), r"\(1\)"),
        (encode({"full": 1}), r"\(1\)"),
        (encode({1: 1}), r"\(1\)"),
        (encode({"diff": -1}), r"\(0\)"),
        (encode({"diff": True}), r"\(0\)"),
        (encode({"diff": "1"}), r"\(0\)"),
        (encode({"cursor": 1}), r"\(1\)"),
    ],
)
def test_malformed_queries_are_refused(query: bytes, message: str) -> None:
    with pytest.raises(RossecError, match=message):
        read_query(query)
