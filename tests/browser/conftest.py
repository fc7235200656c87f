"""One Chromium and one site for the tests of a module: they follow each other, as days do."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import expect

from tests.support.browser import WAIT_MS, Chromium, Window, running_chromium
from tests.support.consolesite import ConsoleSite, console_site, with_robot
from tests.support.pagecheck import PageCheck, from_environment
from tests.support.person import set_up

expect.set_options(timeout=WAIT_MS)  # its own default, 5 s, is short on a busy machine


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    with running_chromium(tmp_path_factory.mktemp("chromium")) as running:
        yield running


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ConsoleSite]:
    """Authority, master, a robot and two who look, and a console; the key is unlocked."""
    with console_site(tmp_path_factory.mktemp("site")) as site:
        site.start_authority()
        site.start_master()
        with_robot(site)
        site.start_console()
        yield site


@pytest.fixture(scope="module")
def phone(chromium: Chromium, site: ConsoleSite) -> Iterator[Window]:
    """A phone that is set up and logged in; nothing may go wrong in it in the whole module."""
    with chromium.window(site.origin) as window:
        set_up(window, site)
        yield window


@pytest.fixture(scope="session")
def check() -> PageCheck:
    return from_environment()
