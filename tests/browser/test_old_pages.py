"""A page whose console, or whose authority, is gone says that it is old, and since when."""

import contextlib
import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Locator, expect

from tests.support.browser import DESKTOP, Chromium, Window
from tests.support.consolesite import ConsoleSite, console_site
from tests.support.pagecheck import PageCheck
from tests.support.person import heading, only_look

pytestmark = pytest.mark.browser
SINCE = re.compile(r"^Not up to date since \d\d:\d\d\.")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ConsoleSite]:
    with console_site(tmp_path_factory.mktemp("site")) as site:
        site.start_authority()
        site.start_console()
        yield site


@pytest.fixture
def wall(chromium: Chromium, site: ConsoleSite) -> Iterator[Window]:
    """A screen that shows the first page, and that nobody touches."""
    with chromium.window(site.origin, size=DESKTOP, checked=False) as window:
        only_look(window, site)
        expect(told(window)).to_be_hidden()
        yield window


def told(window: Window) -> Locator:
    return window.page.locator("[data-stale]")


def test_an_authority_that_ended_is_told_and_its_return_ends_that(
    wall: Window, site: ConsoleSite, check: PageCheck
) -> None:
    site.authority.stop()
    expect(told(wall)).to_have_text(SINCE, timeout=40_000)
    check(wall, "today-old", "phone")
    site.start_authority()
    expect(told(wall)).to_be_hidden(timeout=40_000)
    assert heading(wall).endswith(("for you", "waits for you"))


def test_a_console_that_hangs_is_told(wall: Window, site: ConsoleSite) -> None:
    """No connection ends: only the signs of life stay out."""
    group = family(site.console.process.pid)
    for each in group:
        os.kill(each, signal.SIGSTOP)
    try:
        expect(told(wall)).to_have_text(SINCE, timeout=60_000)
    finally:
        for each in group:
            os.kill(each, signal.SIGCONT)
    expect(told(wall)).to_be_hidden(timeout=60_000)


def family(process: int) -> list[int]:
    """A process and all that it started."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it has ended meanwhile
            parents[int(path.parent.name)] = int(path.read_text().rpartition(")")[2].split()[1])
    found = [process]
    for each in found:
        found += [child for child, parent in parents.items() if parent == each]
    return found


def test_a_console_that_ended_is_told_and_the_next_one_asks_who_is_there(
    wall: Window, site: ConsoleSite
) -> None:
    before = heading(wall)
    site.console.stop()
    expect(told(wall)).to_have_text(SINCE, timeout=40_000)
    assert heading(wall) == before, "what it shows is old, and still there"
    site.start_console()
    expect(wall.page.locator("h1")).to_have_text("Who is there?", timeout=40_000)
