"""The audit: each line bound to the one before, bounded, and still there after a rotation."""

import json
import logging
import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from rossec.errors import ConfigurationError
from rossec.master.audit import BURST, FIRST, AuditFile, Entry, chained, read, verify


class Book:
    """An audit with a clock of its own."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.now = 1000.0
        self.open()

    def open(self) -> None:
        self.file = AuditFile(self.path, lambda: self.now)

    def write(self, text: str) -> None:
        self.file.emit(logging.makeLogRecord({"msg": text, "levelname": "WARNING"}))

    def entries(self, path: Path | None = None) -> list[Entry]:
        return list(read((path or self.path).read_text().splitlines()))


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


def test_whatever_is_changed_shows(book: Book) -> None:
    for text in ("one", "two", "three"):
        book.write(text)
    one, two, three = book.entries()
    with pytest.raises(ConfigurationError, match="line 2 of the audit was changed"):
        verify([one, {**two, "text": "nothing"}, three])
    with pytest.raises(ConfigurationError, match=r"before line 2 .* missing"):
        verify([one, three])
    with pytest.raises(ConfigurationError, match="missing"):
        verify([one, chained({"before": "x", "text": "in between"}, "x"), two])
    with pytest.raises(ConfigurationError, match="before line 1"):
        verify([two, three], FIRST)
    with pytest.raises(ConfigurationError, match="missing"):
        verify([{"hash": "x"}])


@pytest.mark.parametrize("line", ["", "x", "[]", "{}", '{"hash": 1}', "{" + " " * 9000 + "}"])
def test_what_is_no_line_is_refused(line: str) -> None:
    with pytest.raises(ConfigurationError, match="line 1 of the audit is damaged"):
        list(read([line]))


def test_it_goes_on_after_a_restart_and_a_torn_line(book: Book) -> None:
    book.write("one")
    book.file.close()
    book.file.close()
    with book.path.open("a") as file:
        file.write('{"at": 5, "bef')
    book.open()
    book.write("two")
    lines = book.path.read_text().splitlines()
    verify(read([lines[0], lines[2]]), FIRST)


def test_it_goes_on_in_a_new_file_after_a_rotation(book: Book) -> None:
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


def test_a_flood_is_counted_not_written(book: Book) -> None:
    for number in range(BURST + 7):
        book.write(str(number))
    assert len(book.entries()) == BURST
    book.now += 1
    book.write("later")
    assert book.entries()[-1]["left_out"] == 7
    verify(book.entries(), FIRST)


def test_a_disk_that_fails_is_no_reason_to_end(
    book: Book, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda *_: os.close(1 << 20))
        book.write("one")
    assert "Bad file descriptor" in capsys.readouterr().err
    book.write("two")
    verify(book.entries(), FIRST)
