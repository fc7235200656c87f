import logging

import pytest

from rossec.errors import ConfigurationError
from rossec.inprocess.report import LogBridge, Reporter


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
    monkeypatch.setattr("rossec.inprocess.report._REMEMBERED", 2)
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
        reporter.warn(f"refused {number}")
    reporter.close()
    assert len(said) == 30
    assert said[-1] == "rossec: more than 30 different warnings; some are left out"
