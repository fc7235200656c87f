"""The load of a benchmark ends when a master does not answer, and says so."""

import multiprocessing
import socket

import pytest

from bench import _lines, _population
from bench._lines import Line, drive


def test_a_master_that_does_not_answer_ends_the_load(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_lines, "WITHIN", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        line = Line(silent.getsockname()[1])
        with line.sock, pytest.raises(AssertionError, match="no answer to 1 of 1 lines"):
            drive([line], [[line.write(("getPid", "/a"))]])


def test_nodes_that_failed_are_not_waited_for() -> None:
    process = multiprocessing.Process(target=int)
    process.start()
    with pytest.raises(RuntimeError, match="not all nodes came"):
        _population._wait(process, multiprocessing.Queue())
