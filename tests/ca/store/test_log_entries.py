from typing import Any

import pytest

from ca.encoding import Value
from ca.errors import LogDamaged
from ca.keys.signing import Profile
from ca.revocation.merkle import Tree
from ca.store import values
from ca.store.values import (
    Head,
    LogEntry,
    check_entries,
    check_head,
    digest_of,
    extend_peaks,
    open_head,
    sign_head,
)
from tests.support.pki import NOW, new_signer

KEY = new_signer()


def entry(number: int, what: str = "grant") -> LogEntry:
    return LogEntry(number, NOW + number, what, "/a", "detail", digest_of((number, "/a", b"x")))


def recorded(size: int) -> list[tuple[LogEntry, bytes]]:
    rows, peaks = [], b""
    for number in range(size):
        peaks = extend_peaks(peaks, entry(number))
        rows.append((entry(number), peaks))
    return rows


def test_a_log_as_it_was_written() -> None:
    tree = check_entries(recorded(9))
    assert tree.root() == Tree(values.leaf(entry(number)) for number in range(9)).root()
    assert len(check_entries([])) == 0


@pytest.mark.parametrize("wrong", [0, 4, 8])
@pytest.mark.parametrize(
    "change", [{"at": 0}, {"what": "x"}, {"subject": "/b"}, {"detail": ""}, {"digest": b""}]
)
def test_the_wrong_entry_is_named(wrong: int, change: dict[str, Any]) -> None:
    rows = recorded(9)
    rows[wrong] = (rows[wrong][0]._replace(**change), rows[wrong][1])
    with pytest.raises(LogDamaged, match=f"log entry {wrong} was changed"):
        check_entries(rows)


def test_a_missing_entry_is_named() -> None:
    rows = recorded(9)
    del rows[5]
    with pytest.raises(LogDamaged, match="log entry 5 is missing"):
        check_entries(rows)


def test_changed_peaks_are_named() -> None:
    rows = recorded(3)
    rows[1] = (rows[1][0], bytes(32))
    with pytest.raises(LogDamaged, match="log entry 1 was changed"):
        check_entries(rows)


def test_rows_are_told_apart() -> None:
    assert digest_of((1, "ab", b"c")) != digest_of((1, "a", b"bc"))
    assert len(digest_of(())) == 32


def test_a_head_is_signed() -> None:
    head = Head(7, b"r" * 32, NOW)
    assert open_head(sign_head(KEY, head), KEY.public_key) == head


def test_a_head_the_log_had() -> None:
    tree = check_entries(recorded(9))
    check_head(tree, Head(4, tree.root(4), NOW))
    check_head(tree, Head(9, tree.root(), NOW))
    with pytest.raises(LogDamaged, match="the first 4 entries of the log are not those"):
        check_head(tree, Head(4, tree.root(5), NOW))
    with pytest.raises(LogDamaged, match="9 entries where 10 were signed: its end is missing"):
        check_head(tree, Head(10, tree.root(), NOW))


def test_heads_of_another_authority_are_refused() -> None:
    head = Head(7, b"r" * 32, NOW)
    for data in (b"", sign_head(new_signer(), head), Profile("x+cwt").sign(KEY, {}), bytes(513)):
        with pytest.raises(LogDamaged, match="this is not a signed head"):
            open_head(data, KEY.public_key)


@pytest.mark.parametrize(
    "payload",
    [
        {},
        [],
        {6: NOW, -70011: 1},
        {6: NOW, -70011: 1, -70012: b"r" * 31},
        {6: NOW, -70011: -1, -70012: b"r" * 32},
        {6: NOW, -70011: True, -70012: b"r" * 32},
        {6: 1 << 53, -70011: 1, -70012: b"r" * 32},
        {6: NOW, -70011: 1, -70012: "r" * 32},
        {6: NOW, -70011: 1, -70012: b"r" * 32, 7: 1},
    ],
)
def test_unknown_or_missing_fields_are_refused(payload: Value) -> None:
    with pytest.raises(LogDamaged, match="missing or unknown fields"):
        open_head(values.HEAD_PROFILE.sign(KEY, payload), KEY.public_key)
