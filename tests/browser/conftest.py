"""One Chromium and one site for the tests of a module: they follow each other, as days do."""

from collections.abc import Iterator

import pytest

from tests.support.browser import Chromium, running_chromium
from tests.support.consolesite import ConsoleSite, console_site, with_robot
from tests.support.pagecheck import PageCheck


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


@pytest.fixture(scope="session")
def check(tmp_path_factory: pytest.TempPathFactory) -> PageCheck:
    return PageCheck(tmp_path_factory.mktemp("pictures"))
