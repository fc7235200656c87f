import logging
import threading

import pytest

from rossec.errors import ConfigurationError
from rossec.inprocess.process import CallReporter, LogBridge
from tests.rossec.net.test_forks import in_child


def test_each_cause_is_logged_once_with_its_hint() -> None:
    written: list[str] = []
    reporter = CallReporter(written.append)
    for _ in range(3):
        reporter.warn("cannot publish /x", ConfigurationError("no\ngrant", "ask"))
        reporter.warn("plainly")
    reporter.close()
    assert written == ["rossec: cannot publish /x: no\\u000agrant (hint: ask)", "rossec: plainly"]


def test_a_failure_after_a_success_is_logged_again() -> None:
    written: list[str] = []
    reporter = CallReporter(written.append)
    reporter.warn("cannot call /x", OSError("gone"))
    reporter.forget("cannot call /x")
    reporter.warn("cannot call /x", OSError("gone"))
    reporter.close()
    assert len(written) == 2


def test_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rossec.inprocess.process.REMEMBERED", 2)
    written: list[str] = []
    reporter = CallReporter(written.append)
    for text in ("a", "b", "c", "a"):
        reporter.warn(text)
    reporter.close()
    assert len(written) == 4


def test_warnings_of_our_loggers_are_written() -> None:
    written: list[str] = []
    reporter = CallReporter(written.append)
    log = logging.getLogger("rossec.test_report")
    log.propagate = False
    log.addHandler(LogBridge(reporter))
    log.warning("%s is out of reach", "/master")
    log.info("not written")
    reporter.close()
    assert written == ["rossec: /master is out of reach"]


def test_unauthenticated_peers_cannot_flood_the_log() -> None:
    written: list[str] = []
    reporter = CallReporter(written.append)
    for number in range(100):
        reporter.warn(f"refused /eve: {number}")
        reporter.warn(f"refused /mallory: {number}")
        reporter.warn(f"cannot call http://{number}")
    assert len(written) <= 31
    reporter.warn("lost /robot: gone")
    for number in range(100):
        reporter.warn(f"refused the caller from 10.0.0.{number}")
    reporter.close()
    assert len(written) == 61
    assert written.count("rossec: too many different warnings; some are suppressed") == 1
    assert [sum(name in line for line in written) for name in ("/eve", "/mallory", "/robot")] == [10, 10, 1]


def test_threads_may_warn_and_forget_at_once() -> None:
    written: list[str] = []
    reporter = CallReporter(written.append)
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
    assert written


def test_a_line_that_cannot_be_written_does_not_suppress_others() -> None:
    written: list[str] = []

    def write(line: str) -> None:
        if "bad" in line:
            raise ValueError(line)
        written.append(line)

    reporter = CallReporter(write)
    for text in ("one", "bad", "two"):
        reporter.warn(text)
    reporter.close()
    assert written == ["rossec: one", "rossec: two"]
    reporter.close()


def test_a_forked_process_has_its_own_thread() -> None:
    written: list[str] = []
    reporter = CallReporter(written.append)
    reporter.warn("from the parent")

    def work() -> list[str]:
        written.clear()
        reporter.warn("from the child")
        reporter.close()
        return written

    assert in_child(work) == "['rossec: from the child']"
    reporter.close()
