"""What every page gets."""

import pytest

from rossec.console.context import ConsoleContext
from rossec.console.server.control import WebSettings
from tests.support.consolepages import ORIGIN, Browser, MemoryClient
from tests.support.consoleservice import FakeHome


def test_a_console_begins_with_nobody_and_nothing() -> None:
    context = ConsoleContext(MemoryClient(FakeHome()), WebSettings("home", (ORIGIN,)))
    assert (len(context.sessions), context.news.streams, len(context.enrollments)) == (0, 0, 0)
    assert context.scanner is None


def test_its_sessions_last_as_long_as_its_settings_say() -> None:
    browser = Browser(settings=WebSettings("home", (ORIGIN,), lifetime=100, idle=50)).log_in()
    browser.now += 49
    assert browser.get("/phones").status_code == 200
    browser.now += 49
    assert browser.get("/phones").status_code == 200
    browser.now += 2
    assert browser.get("/phones").status_code == 303


def test_an_enrollment_that_changes_is_news() -> None:
    context = Browser().context
    context.news.changed()
    assert context.news.number is None  # nobody waits


@pytest.mark.attack("clock-ahead")
def test_a_clock_that_is_ahead_for_a_look_ends_no_session() -> None:
    browser = Browser().log_in()
    browser.elapsed = 5.0
    browser.context.sessions.begin(b"t" * 32, "", browser.elapsed)
    browser.log_in()
    browser.now += 10 * 86400
    browser.get("/")
    browser.now -= 10 * 86400
    assert browser.get("/").status_code == 200
    browser.elapsed += 9 * 3600
    assert browser.get("/").status_code == 303
