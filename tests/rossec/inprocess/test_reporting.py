import logging
import threading

import pytest

from rossec.errors import ConfigurationError
from rossec.inprocess.reporting import LogBridge, Reporter
from tests.rossec.net.test_forks import in_child


def test_each_cause_is_said_once_with_its_hint() -> None:
    said: list[str] = []
    reporter = Reporter(said.append)
    for _ in range(3):
        reporter.warn("cannot publish /x", ConfigurationError("no\ngrant", "ask"))
        reporter.warn("plainly")
    reporter.close()
    assert said == ["rossec: cannot publish /x: no\\u000agrant (hint: ask)", "rossec: plainly"]


def test_what_went_well_since_is_news_when_it_fails_again() -> None:
    said: list[str] = []
    reporter = Reporter(said.append)
    reporter.warn("cannot call /x", OSError("gone"))
    reporter.forget("cannot call /x")
    reporter.warn("cannot call /x", OSError("gone"))
    reporter.close()
    assert len(said) == 2


def test_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rossec.inprocess.reporting._REMEMBERED", 2)
    said: list[str] = []
    reporter = Reporter(said.append)
    for text in ("a", "b", "c", "a"):
        reporter.warn(text)
    reporter.close()
    assert len(said) == 4


def test_warnings_of_our_loggers_are_said_too() -> None:
    said: list[str] = []
    reporter = Reporter(said.append)
    log = logging.getLogger("rossec.test_report")
    log.propagate = False
    log.addHandler(LogBridge(reporter))
    log.warning("%s is out of reach", "/master")
    log.info("not said")
    reporter.close()
    assert said == ["rossec: /master is out of reach"]


def test_strangers_cannot_flood_the_log() -> None:
    said: list[str] = []
    reporter = Reporter(said.append)
    for number in range(100):
        reporter.warn(f"refused /eve: {number}")
        reporter.warn(f"refused /mallory: {number}")
        reporter.warn(f"cannot call http://{number}")
    assert len(said) <= 31
    reporter.warn("lost /robot: gone")
    for number in range(100):
        reporter.warn(f"refused the caller from 10.0.0.{number}")
    reporter.close()
    assert len(said) == 61
    assert said.count("rossec: more different warnings than are written; some are left out") == 1
    assert [sum(name in line for line in said) for name in ("/eve", "/mallory", "/robot")] == [
        10, 10, 1,
    ]  # fmt: skip


def test_threads_may_warn_and_forget_at_once() -> None:
    said: list[str] = []
    reporter = Reporter(said.append)
    going = threading.Event()

    def warn() -> None:
        number = 0
        while not going.is_set():
            number += 1
            reporter.warn(f"refused {number % 300}")

    thread = threading.Thread(target=warn)
    thread.start()
    try:
        for _ in range(300):
            reporter.forget("refused 1")
    finally:
        going.set()
        thread.join()
    reporter.close()
    assert said


def test_one_line_that_cannot_be_written_does_not_silence_the_others() -> None:
    said: list[str] = []

    def write(line: str) -> None:
        if "bad" in line:
            raise ValueError(line)
        said.append(line)

    reporter = Reporter(write)
    for text in ("one", "bad", "two"):
        reporter.warn(text)
    reporter.close()
    assert said == ["rossec: one", "rossec: two"]
    reporter.close()


def test_a_forked_process_speaks_for_itself() -> None:
    said: list[str] = []
    reporter = Reporter(said.append)
    reporter.warn("from the parent")

    def work() -> list[str]:
        said.clear()
        reporter.warn("from the child")
        reporter.close()
        return said

    assert in_child(work) == "['rossec: from the child']"
    reporter.close()
