"""The journal file of parameters."""

import os
import stat
from pathlib import Path

import pytest

from rossec.errors import NotWritten
from rossec.master.server import parameter_file as module
from rossec.master.server.parameter_file import ParameterFile
from rossec.master.state.parameter_journal import MAGIC, ParameterChange, decode
from tests.rossec.test_files import no_room


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "parameters.journal"


def opened(path: Path) -> ParameterFile:
    parameter_file = ParameterFile(path)
    parameter_file.open()
    return parameter_file


def change(parameter_file: ParameterFile, key: str, value: object) -> None:
    parameter_file.parameters.set(key, value)
    parameter_file.write(ParameterChange(key, value))


def test_a_change_survives_without_a_close(path: Path) -> None:
    parameter_file = opened(path)
    parameter_file.write(ParameterChange("/a", 1))
    again = opened(path)
    assert again.parameters.get("/") == {"a": 1}
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    parameter_file.close()
    again.close()
    parameter_file.write(ParameterChange("/b", 1))  # closed: nothing happens
    parameter_file.close()
    assert opened(path).parameters.get("/") == {"a": 1}


def test_a_truncated_record_is_removed_and_saved_aside(
    path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    parameter_file = opened(path)
    parameter_file.write(ParameterChange("/a", 1))
    parameter_file.close()
    whole = path.read_bytes()
    path.write_bytes(whole + whole[len(MAGIC) : -3])
    parameter_file = opened(path)
    parameter_file.write(ParameterChange("/b", 2))
    assert opened(path).parameters.get("/") == {"a": 1, "b": 2}
    assert "damaged" in caplog.text
    assert path.with_suffix(".damaged").read_bytes().startswith(whole)


def test_the_file_is_compacted_when_it_has_grown(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "REWRITE_MIN", 1000)
    parameter_file = opened(path)
    for number in range(100):
        parameter_file.parameters.set("/a", number)
        parameter_file.write(ParameterChange("/a", number))
    assert len(decode(path.read_bytes())[0]) == 100
    parameter_file.sync()
    assert decode(path.read_bytes())[0] == [ParameterChange("/a", 99)]
    parameter_file.write(ParameterChange("/b", 1))
    parameter_file.sync()
    parameter_file.sync()
    assert opened(path).parameters.get("/") == {"a": 99, "b": 1}


def test_a_full_disk_is_reported_and_leaves_no_half_record(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    parameter_file = opened(path)
    change(parameter_file, "/a", 1)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fdatasync", lambda fd: os.fsync(1 << 20))
        parameter_file.sync()
    write = os.write
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda fd, data: write(fd, data[:5]))
        change(parameter_file, "/b", 2)
    assert caplog.text.count("parameters cannot be saved") == 2
    change(parameter_file, "/c", 3)
    assert opened(path).parameters.get("/") == {"a": 1, "c": 3}


def test_a_change_lost_to_a_full_disk_is_written_later(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parameter_file = opened(path)
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda fd, data: os.fsync(1 << 20))
        change(parameter_file, "/a", 1)
    with monkeypatch.context() as patch:
        patch.setattr("rossec.files.replace", lambda *_: os.fsync(1 << 20))
        parameter_file.sync()  # still no space
    assert decode(path.read_bytes())[0] == []
    parameter_file.sync()
    assert opened(path).parameters.get("/") == {"a": 1}


def test_the_file_is_compacted_at_once_when_it_grows_too_fast(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "REWRITE_MIN", 1000)
    monkeypatch.setattr(module, "MAX_UNSYNCED", 10_000)
    parameter_file = opened(path)
    for number in range(200):
        change(parameter_file, "/a", number)
        assert path.stat().st_size < 11_000
    assert opened(path).parameters.get("/") == {"a": 199}


def test_a_full_disk_is_logged_and_the_file_is_unchanged(
    path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    kept, reason = opened(path), "they are in force, and saved as soon as there is room"
    before = path.read_bytes()
    with no_room():
        change(kept, "/a", 1)
        kept.sync()
        assert path.read_bytes() == before
        with pytest.raises(NotWritten, match=r"parameters\.journal was not written"):
            ParameterFile(path).open()
    assert [reason in message for message in caplog.messages] == [True, True]
    kept.close()  # now there is space
    again = opened(path)
    assert again.parameters.get("/a") == 1
    again.close()
