"""The file that outlives the master."""

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
    memory = ParameterFile(path)
    memory.open()
    return memory


def change(memory: ParameterFile, key: str, value: object) -> None:
    memory.parameters.set(key, value)
    memory.write(ParameterChange(key, value))


def test_a_change_survives_without_a_close(path: Path) -> None:
    memory = opened(path)
    memory.write(ParameterChange("/a", 1))
    again = opened(path)
    assert again.parameters.get("/") == {"a": 1}
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    memory.close()
    again.close()
    memory.write(ParameterChange("/b", 1))  # closed: nothing happens
    memory.close()
    assert opened(path).parameters.get("/") == {"a": 1}


def test_a_torn_end_is_cut_off_and_kept_aside(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    memory = opened(path)
    memory.write(ParameterChange("/a", 1))
    memory.close()
    whole = path.read_bytes()
    path.write_bytes(whole + whole[len(MAGIC) : -3])
    memory = opened(path)
    memory.write(ParameterChange("/b", 2))
    assert opened(path).parameters.get("/") == {"a": 1, "b": 2}
    assert "damaged" in caplog.text
    assert path.with_suffix(".damaged").read_bytes().startswith(whole)


def test_it_is_rewritten_when_it_has_grown(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SMALL", 1000)
    memory = opened(path)
    for number in range(100):
        memory.parameters.set("/a", number)
        memory.write(ParameterChange("/a", number))
    assert len(decode(path.read_bytes())[0]) == 100
    memory.sync()
    assert decode(path.read_bytes())[0] == [ParameterChange("/a", 99)]
    memory.write(ParameterChange("/b", 1))
    memory.sync()
    memory.sync()
    assert opened(path).parameters.get("/") == {"a": 99, "b": 1}


def test_a_full_disk_is_reported_and_leaves_no_half_record(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    memory = opened(path)
    change(memory, "/a", 1)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fdatasync", lambda fd: os.fsync(1 << 20))
        memory.sync()
    write = os.write
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda fd, data: write(fd, data[:5]))
        change(memory, "/b", 2)
    assert caplog.text.count("parameters cannot be kept") == 2
    change(memory, "/c", 3)
    assert opened(path).parameters.get("/") == {"a": 1, "c": 3}


def test_what_a_full_disk_did_not_take_is_written_when_there_is_room(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    memory = opened(path)
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda fd, data: os.fsync(1 << 20))
        change(memory, "/a", 1)
    with monkeypatch.context() as patch:
        patch.setattr("rossec.files.replace", lambda *_: os.fsync(1 << 20))
        memory.sync()  # there is still none
    assert decode(path.read_bytes())[0] == []
    memory.sync()
    assert opened(path).parameters.get("/") == {"a": 1}


def test_it_is_rewritten_at_once_when_it_grows_too_fast(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "SMALL", 1000)
    monkeypatch.setattr(module, "LARGE", 10_000)
    memory = opened(path)
    for number in range(200):
        change(memory, "/a", number)
        assert path.stat().st_size < 11_000
    assert opened(path).parameters.get("/") == {"a": 199}


def test_a_disk_without_room_is_said_and_the_file_is_as_it_was(
    path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    kept, said = opened(path), "they are in force, and kept as soon as there is room"
    before = path.read_bytes()
    with no_room():
        change(kept, "/a", 1)
        kept.sync()
        assert path.read_bytes() == before
        with pytest.raises(NotWritten, match=r"parameters\.journal was not written"):
            ParameterFile(path).open()
    assert [said in message for message in caplog.messages] == [True, True]
    kept.close()  # now there is
    again = opened(path)
    assert again.parameters.get("/a") == 1
    again.close()
