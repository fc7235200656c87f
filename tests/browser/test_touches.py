"""What a person touches in the moment in which the page loads itself again counts."""

import re

import pytest
from playwright.sync_api import Route, expect

from tests.support.browser import Chromium
from tests.support.consolesite import ASKED, ConsoleSite
from tests.support.person import set_up

pytestmark = pytest.mark.browser
CLICK = """() => {
    const buttons = [...document.querySelectorAll("button")];
    const today = buttons.find(each => each.textContent.trim().startsWith("Today"));
    addEventListener("beforeunload", () => setTimeout(() => today.click(), 200), {once: true});
}"""


def ask(site: ConsoleSite, topic: str) -> None:
    site.run("grant", "request", "/lamp", "--subscribe", topic, "--why", "to know")


def test_a_touch_while_the_page_loads_itself_again_counts(chromium: Chromium, site: ConsoleSite) -> None:
    with chromium.window(site.origin, checked=False) as other:  # a request is cut off
        set_up(other, site, "another phone")
        site.write_policy(ASKED)
        site.enroll("/lamp")
        ask(site, "/hall/light")
        other.open("/")
        other.page.get_by_role("link", name="Look at it").click()
        other.page.wait_for_url(re.compile("/ask/"))
        other.page.evaluate(CLICK)
        held: list[Route] = []
        other.page.route("**/ask/*", lambda route: held.append(route))  # noqa: PLW0108 - needs a function
        ask(site, "/hall/door")
        expect(other.page.locator(".end-mark")).to_have_count(1, timeout=60_000)
        assert held, "nothing loaded the page again"
