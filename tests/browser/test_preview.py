"""`rossec console --preview`: pictures are made up until the node /console may receive a topic."""

from collections.abc import Iterator
from typing import Final

import pytest
from playwright.sync_api import Locator, expect

from rossec.console.preview import NAME
from tests.support.browser import Chromium, Window
from tests.support.consolesite import POSE, SCAN, ConsoleSite, console_site, with_robot
from tests.support.pagecheck import PageCheck
from tests.support.person import only_look

pytestmark = pytest.mark.browser

SEEN_WITHIN: Final = 40_000  # ms: the receiver looks for topics, and the page is loaded again


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ConsoleSite]:
    """A robot and two who look; `/console` is enrolled, and may receive nothing yet."""
    with console_site(tmp_path_factory.mktemp("site")) as site:
        site.start_authority()
        site.start_master()
        with_robot(site)
        site.enroll(NAME)
        site.start_console("--preview")
        yield site


@pytest.fixture(scope="module")
def screen(chromium: Chromium, site: ConsoleSite) -> Iterator[Window]:
    """Somebody who looks, which is enough for pictures."""
    with chromium.window(site.origin) as window:
        only_look(window, site)
        yield window


def below_the_pictures(screen: Window) -> Locator:
    """The sentence that says where what is drawn comes from."""
    return screen.page.locator(".looks + p")


def look_until(screen: Window, path: str, text: str) -> None:
    """Load the page of a topic until it says `text` below its pictures."""
    for _ in range(SEEN_WITHIN // 500):
        screen.open(path)
        if text in below_the_pictures(screen).inner_text():
            return
        screen.page.wait_for_timeout(500)
    raise AssertionError(below_the_pictures(screen).inner_text())


def test_what_it_may_not_receive_is_made_up_and_the_page_says_so(screen: Window) -> None:
    for topic in (POSE, SCAN):
        screen.open(f"/see{topic}")
        expect(below_the_pictures(screen)).to_contain_text("Made up.")
        expect(below_the_pictures(screen)).to_contain_text("not what the robot does")


def test_a_topic_that_it_was_granted_is_drawn_from_what_it_received(
    screen: Window, site: ConsoleSite, check: PageCheck
) -> None:
    site.grant(NAME, "--subscribe", POSE)
    look_until(screen, f"/see{POSE}", "The last minute")
    expect(below_the_pictures(screen)).not_to_contain_text("Made up")
    expect(below_the_pictures(screen)).to_contain_text("kept in memory only")
    expect(screen.page.locator(".looks .frame").first).to_be_visible()
    check(screen, "see-preview")


def test_it_is_shown_among_those_who_see_the_topic(screen: Window) -> None:
    screen.open(f"/see{POSE}")
    row = screen.page.locator("ul.states li", has_text=NAME)
    expect(row).to_contain_text("all of it")


def test_another_topic_stays_made_up(screen: Window) -> None:
    screen.open(f"/see{SCAN}")
    expect(below_the_pictures(screen)).to_contain_text("Made up.")
    expect(screen.page.locator("ul.states li", has_text=NAME)).to_contain_text("nothing")
