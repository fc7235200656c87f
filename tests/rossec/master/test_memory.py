"""The file that outlives the master."""

import os
import stat
from pathlib import Path

import pytest

from rossec.master import memory as module
from rossec.master.journal import MAGIC, Change, decode
from rossec.master.memory import ParameterFile


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "parameters.journal"


def opened(path: Path) -> ParameterFile:
    memory = ParameterFile(path)
    memory.open()
    return memory


def test_a_change_survives_without_a_close(path: Path) -> None:
    memory = opened(path)
    memory.write(Change("/a", 1))
    again = opened(path)
    assert again.parameters.get("/") == {"a": 1}
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    memory.close()
    again.close()
    memory.write(Change("/b", 1))  # closed: nothing happens
    memory.close()
    assert opened(path).parameters.get("/") == {"a": 1}


def test_a_torn_end_is_cut_off_and_kept_aside(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    memory = opened(path)
    memory.write(Change("/a", 1))
    memory.close()
    whole = path.read_bytes()
    path.write_bytes(whole + whole[len(MAGIC) : -3])
    memory = opened(path)
    memory.write(Change("/b", 2))
    assert opened(path).parameters.get("/") == {"a": 1, "b": 2}
    assert "damaged" in caplog.text
    assert path.with_suffix(".damaged").read_bytes().startswith(whole)


def test_it_is_rewritten_when_it_has_grown(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SMALL", 1000)
    memory = opened(path)
    for number in range(100):
        memory.parameters.set("/a", number)
        memory.write(Change("/a", number))
    assert len(decode(path.read_bytes())[0]) == 100
    memory.sync()
    assert decode(path.read_bytes())[0] == [Change("/a", 99)]
    memory.write(Change("/b", 1))
    memory.sync()
    memory.sync()
    assert opened(path).parameters.get("/") == {"a": 99, "b": 1}


def test_a_full_disk_is_reported_and_leaves_no_half_record(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    memory = opened(path)
    memory.write(Change("/a", 1))
    write = os.write
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda fd, data: write(fd, data[:5]))
        memory.write(Change("/b", 2))
    with monkeypatch.context() as patch:
        patch.setattr(os, "fdatasync", lambda fd: os.fsync(1 << 20))
        memory.sync()
    assert caplog.text.count("parameters cannot be kept") == 2
    memory.write(Change("/c", 3))
    memory.close()
    assert opened(path).parameters.get("/") == {"a": 1, "c": 3}
