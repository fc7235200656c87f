"""Processes in /proc, also with reused PIDs."""

import os
import socket
from pathlib import Path

import pytest

from rossec.host import callers
from rossec.host.callers import descendants, descends, descriptors, parents, process, socket_at

NO_PID = 1 << 30


def test_descendants() -> None:
    family = [(2, 1), (3, 2), (4, 3), (5, 1), (6, 9)]
    assert sorted(descendants(family, 2)) == [3, 4]
    assert sorted(descendants(family, 1)) == [2, 3, 4, 5]
    assert descendants(family, 4) == []


def test_parents_includes_this_process() -> None:
    assert (os.getpid(), os.getppid()) in set(parents())


def test_descends_is_false_for_itself_and_for_dead_processes() -> None:
    assert descends(os.getpid(), os.getppid())
    assert not descends(os.getpid(), os.getpid())
    assert not descends(os.getppid(), os.getpid())
    assert not descends(NO_PID, os.getpid())


@pytest.fixture
def fake_proc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A fake /proc: 9 is a child of 5, 5 of 3; with a program name that is hard to parse."""
    monkeypatch.setattr(callers, "PROC", tmp_path)
    for pid, parent, started in ((3, 2, 100), (5, 3, 200), (9, 5, 300)):
        (tmp_path / str(pid)).mkdir()
        write(tmp_path, pid, parent, started)
    return tmp_path


def write(proc: Path, pid: int, parent: int, started: int) -> None:
    rest = f"S {parent}" + " 0" * 17 + f" {started} 0 0\n"
    (proc / str(pid) / "stat").write_text(f"{pid} (a ) b 7 (c) {rest}")


def test_grandchildren_descend(fake_proc: Path) -> None:
    assert descends(9, 3)
    assert descends(5, 3)
    assert not descends(9, 4)
    assert sorted(parents()) == [(3, 2), (5, 3), (9, 5)]
    assert process(9) == (9, 300)


def test_a_parent_younger_than_its_child_is_refused(fake_proc: Path) -> None:
    """Its PID was reused by a descendant while the chain was read."""
    write(fake_proc, 5, 3, 301)
    assert not descends(9, 3)
    assert descends(5, 3)


def test_descriptors_and_their_sockets() -> None:
    with socket.socket() as sock, Path(os.devnull).open() as file:
        names = {str(sock.fileno()), str(file.fileno())}
        assert names <= set(descriptors(os.getpid()))
        assert socket_at(os.getpid(), str(sock.fileno())) == os.fstat(sock.fileno()).st_ino
        assert socket_at(os.getpid(), str(file.fileno())) is None


def test_ended_processes_have_no_descriptors() -> None:
    assert process(NO_PID) is None
    assert descriptors(NO_PID) == []
    assert socket_at(NO_PID, "0") is None
