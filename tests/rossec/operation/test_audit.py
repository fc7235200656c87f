"""The audit: lines are chained, bounded, and continue after a rotation."""

import json
import logging
import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from rossec.errors import ConfigurationError
from rossec.host.audit import (
    FIRST,
    LEFT_OUT,
    AuditFile,
    Entry,
    check_beginning,
    read_entries,
    verify,
    with_hash,
)
from tests.support.pki import new_signer


class Book:
    """An audit with a chosen clock."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.now = 1000.0
        self.open()

    def open(self) -> None:
        self.file = AuditFile(self.path, lambda: self.now)

    def write(self, text: str) -> None:
        self.file.emit(logging.makeLogRecord({"msg": text, "levelname": "WARNING"}))

    def entries(self, path: Path | None = None) -> list[Entry]:
        found, damaged = read_entries((path or self.path).read_text().splitlines())
        assert not damaged
        return found


@pytest.fixture
def book(tmp_path: Path) -> Iterator[Book]:
    book = Book(tmp_path / "audit.log")
    yield book
    book.file.close()


def test_lines_are_chained_and_for_the_owner_alone(book: Book) -> None:
    for text in ("one", "two\nforged", "three"):
        book.write(text)
    assert [entry["text"] for entry in book.entries()] == ["one", "two\\u000aforged", "three"]
    assert verify(book.entries(), FIRST) == book.entries()[-1]["hash"]
    assert stat.S_IMODE(book.path.stat().st_mode) == 0o600
    assert verify([]) == FIRST


def test_every_change_is_detected(book: Book) -> None:
    for text in ("one", "two", "three"):
        book.write(text)
    one, two, three = book.entries()
    with pytest.raises(ConfigurationError, match="line 2 of the audit was changed"):
        verify([one, {**two, "text": "nothing"}, three])
    with pytest.raises(ConfigurationError, match=r"before line 2 .* missing"):
        verify([one, three])
    with pytest.raises(ConfigurationError, match="missing"):
        verify([one, with_hash({"before": "x", "text": "in between"}, "x"), two])
    with pytest.raises(ConfigurationError, match="before line 1"):
        verify([two, three], FIRST)
    with pytest.raises(ConfigurationError, match="missing"):
        verify([{"hash": "x"}])


@pytest.mark.parametrize(
    "line",
    [
        "",
        "x",
        "[]",
        "{}",
        '{"hash": 1}',
        "{" + " " * 9000 + "}",
        "[" * 8000,
        '{"hash": "x", "level": "info", "text": "t"}',
        '{"hash": "x", "level": "info", "text": "t", "at": "now"}',
        '{"hash": "x", "level": "info", "text": "t", "at": 1e400}',
        '{"hash": "x", "level": "info", "text": "t", "at": NaN}',
        '{"hash": "x", "level": "info", "text": "t", "at": -1}',
        '{"hash": "x", "level": "info", "text": 5, "at": 1}',
        '{"hash": "x", "level": 5, "text": "t", "at": 1}',
    ],
)
def test_a_malformed_line_is_damaged_and_hides_no_other(book: Book, line: str) -> None:
    book.write("one")
    book.write("two")
    one, two = book.path.read_text().splitlines()
    found, damaged = read_entries([one, line, two])
    assert [entry["text"] for entry in found] == ["one", "two"]
    assert damaged == [2]


@pytest.mark.parametrize("before", [0, 1, 500])
def test_the_chain_continues_after_a_restart_and_a_truncated_line(book: Book, before: int) -> None:
    for number in range(before):
        book.write(f"{number} " + "x" * 400)
    book.file.close()
    book.file.close()
    with book.path.open("a") as file:
        file.write('{"at": 5, "bef')
    book.open()
    book.write("two")
    book.write("three")
    *_, two, three = book.entries()
    assert (two["cut_short"], "cut_short" in three) == (14, False)
    verify(book.entries(), FIRST)
    assert len(book.entries()) == before + 2


def test_the_chain_continues_after_a_damaged_line(book: Book) -> None:
    book.write("one")
    book.file.close()
    book.path.write_text(book.path.read_text() + "what\n")
    book.open()
    book.write("two")
    one, _, two = book.path.read_text().splitlines()
    verify(read_entries([one, two])[0], FIRST)


def test_the_chain_continues_in_a_new_file_after_rotation(book: Book) -> None:
    book.write("one")
    moved = book.path.with_suffix(".1")
    book.path.rename(moved)
    book.write("two")
    book.write("three")
    assert [entry["text"] for entry in book.entries()] == ["two", "three"]
    verify([*book.entries(moved), *book.entries()], FIRST)
    book.path.rename(book.path.with_suffix(".2"))
    book.path.write_text("")
    book.write("four")
    assert json.loads(book.path.read_text())["text"] == "four"


def test_the_number_of_lines_left_out_is_recorded(book: Book) -> None:
    record = logging.makeLogRecord({"msg": "later", "levelname": "WARNING", LEFT_OUT: 7})
    book.file.emit(record)
    assert book.entries()[-1]["left_out"] == 7
    verify(book.entries(), FIRST)


def test_a_failing_disk_does_not_end_the_master(
    book: Book, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda *_: os.close(1 << 20))
        book.write("one")
        book.write("one more")
    assert caplog.messages == [
        "the audit cannot be written: [Errno 9] Bad file descriptor; the lines before are intact"
    ]
    book.write("two")
    verify(book.entries(), FIRST)


def test_a_full_disk_leaves_no_half_line(
    book: Book, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    book.write("one")
    write = os.write
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda file, data: write(file, data[:20]))
        book.write("two")
    assert caplog.messages == ["the audit cannot be written: the disk is full; the lines before are intact"]
    book.write("three")
    assert [entry["text"] for entry in book.entries()] == ["one", "three"]
    verify(book.entries(), FIRST)


def test_a_removed_directory_leaks_no_descriptor(book: Book, caplog: pytest.LogCaptureFixture) -> None:
    """The number of a closed descriptor may be that of a new connection."""
    book.write("one")
    away = book.path.parent.with_name("away")
    book.path.parent.rename(away)
    book.write("two")
    with (away / "another").open("w") as another:
        book.write("three")
        another.write("still open")
        another.flush()
    assert "No such file" in caplog.text
    away.rename(book.path.parent)
    book.write("four")
    assert [entry["text"] for entry in book.entries()] == ["one", "four"]
    verify(book.entries(), FIRST)


def test_each_file_begins_with_a_line_of_the_master(tmp_path: Path) -> None:
    file = AuditFile(tmp_path / "audit.log", lambda: 1000.25, new_signer())
    note = logging.makeLogRecord({"msg": "one"})
    for text in ("one", "two"):
        file.emit(logging.makeLogRecord({"msg": text}))
    (tmp_path / "audit.log").rename(tmp_path / "audit.log.1")
    file.emit(note)
    file.close()
    again = AuditFile(tmp_path / "audit.log", lambda: 1001.0, new_signer())
    again.emit(note)
    again.close()
    parts = [
        read_entries((tmp_path / name).read_text().splitlines())[0] for name in ("audit.log.1", "audit.log")
    ]
    assert [[entry["text"] for entry in part] for part in parts] == [
        ["the audit begins", "one", "two"],
        ["the audit goes on in a new file", "one", "one"],
    ]
    assert verify([*parts[0], *parts[1]], FIRST) == parts[1][-1]["hash"]
    assert check_beginning(parts[1][0], after=parts[0][-1]["hash"])  # the key is not known here


def test_a_line_of_lone_surrogates_is_a_changed_line() -> None:
    line = json.dumps({"hash": "x", "text": "", "level": "info", "at": 1, "before": "\ud800"})
    entries, damaged = read_entries([line])
    assert damaged == []
    with pytest.raises(ConfigurationError, match="line 1 of the audit was changed"):
        verify(entries)
