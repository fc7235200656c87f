"""Attacks with a second browser: at the same request in the same moment; with a stolen cookie."""

import json
import re
from collections.abc import Callable, Iterator
from typing import Final

import pytest
from playwright.sync_api import Route, expect

from tests.support.browser import Chromium, Window, running_chromium
from tests.support.consolesite import ConsoleSite, console_site
from tests.support.person import log_in, press, set_up, thief

pytestmark = pytest.mark.browser

TODAY: Final = re.compile("^Today")
LIGHT: Final = "/hall/light"
POLICY: Final = """
rossec: 1
robot: the hall
defaults: {decision: prompt, prompt_timeout: 10m}
rules: []
"""


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    with running_chromium(tmp_path_factory.mktemp("chromium")) as running:
        yield running


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ConsoleSite]:
    """An authority, a console, and a lamp that may see one thing and asks for another."""
    with console_site(tmp_path_factory.mktemp("site")) as site:
        policy = site.root / "ca" / "policy.yaml"
        policy.touch(0o600)
        policy.write_text(POLICY)
        site.start_authority()
        site.start_master()
        site.enroll("/lamp", "/porch")
        site.grant("/lamp", "--subscribe", "/hall/door")
        site.start_console()
        yield site


@pytest.fixture(scope="module")
def owner(chromium: Chromium, site: ConsoleSite) -> Iterator[Window]:
    """The browser of the person, logged in."""
    with chromium.window(site.origin, checked=False) as window:
        set_up(window, site)
        yield window


def question_of(owner: Window, site: ConsoleSite) -> str:
    """The address of a new question of `/lamp`."""
    site.run("grant", "request", "/lamp", "--subscribe", LIGHT, "--why", "to know the hour")
    owner.open("/")
    owner.page.get_by_role("link", name="Look at it").click()
    owner.page.wait_for_url(re.compile("/ask/"))
    return owner.page.url.removeprefix(site.origin)


def approvals_of(site: ConsoleSite) -> int:
    return len(json.loads(site.run("console", "approvals", "--json")))


def touch(window: Window, held: list[Route], number: int) -> None:
    """Approve until today. A page that loads itself again in that moment forgets the touch."""
    for _ in range(3):
        press(window, TODAY)
        if wait_on(window, lambda: len(held) == number):
            return
    raise AssertionError("not both have touched")


def wait_on(window: Window, is_so: Callable[[], bool]) -> bool:
    """Whether it is so within 5 s."""
    for _ in range(100):
        if is_so():
            return True
        window.page.wait_for_timeout(50)
    return False


@pytest.mark.attack("console-two-approve")
def test_of_two_browsers_at_one_question_one_wins_and_the_other_is_told(
    chromium: Chromium, owner: Window, site: ConsoleSite
) -> None:
    """Both have touched before either touch has arrived. What the other is told stays until it is read."""
    path, before = question_of(owner, site), approvals_of(site)
    with chromium.window(site.origin, checked=False) as other:
        set_up(other, site, "the other phone")
        other.open(path)
        held: list[Route] = []

        def hold(route: Route) -> None:
            held.append(route)

        for number, window in enumerate((owner, other), 1):
            window.page.route("**/approve/*", hold)
            touch(window, held, number)
        for route in held:
            route.continue_()
        for window in (owner, other):
            end = window.page.locator(".end-mark, [data-problem]:visible")
            expect(end).to_have_count(1, timeout=60_000)
        won = [each for each in (owner, other) if each.page.url.startswith(f"{site.origin}/approved/")]
        (lost,) = [each for each in (owner, other) if each not in won]
        assert len(won) == 1
        problem = lost.page.locator("[data-problem]:visible")
        expect(problem).to_contain_text("This question was answered")
        expect(lost.page.locator("[data-changed]")).to_be_visible()
        expect(problem).to_be_visible()
        lost.open(path)
        expect(lost.page.locator("h1")).to_have_text("Approved")
    owner.page.unroute("**/approve/*")
    assert site.run("grant", "list").count(LIGHT) == 1
    assert approvals_of(site) == before + 1


@pytest.mark.attack("stolen-console-session")
def test_a_stolen_cookie_denies_and_revokes(chromium: Chromium, owner: Window, site: ConsoleSite) -> None:
    """Taking away is never harder than giving, so whoever has the session can."""
    site.run("grant", "request", "/porch", "--subscribe", LIGHT, "--why", "to be seen")
    owner.open("/")
    path = owner.page.get_by_role("link", name="Look at it").last.get_attribute("href")
    with thief(chromium, owner) as other:
        other.open(path or "")
        press(other, "Deny")
        expect(other.page.locator("h1")).to_have_text("Denied")
        other.open("/revoke/node/porch")
        other.page.get_by_label("Type its name").fill("/porch")
        press(other, "Revoke it")
        other.page.wait_for_url(re.compile("/revoked/"))
    owner.open("/node/porch")
    expect(owner.page.locator(".lead")).to_contain_text(re.compile("[Rr]emoved"))


@pytest.mark.attack("stolen-console-session")
@pytest.mark.parametrize("has_passkey", [False, True])
def test_a_stolen_cookie_adds_no_phone(
    chromium: Chromium, owner: Window, site: ConsoleSite, has_passkey: bool
) -> None:
    """It can make a link and propose its own passkey; approving that needs a phone that is there.

    With `has_passkey` the thief's browser answers the question for a passkey by itself.
    """
    phones = site.run("console", "phones", "--json")
    with thief(chromium, owner) as other:
        other.open("/phones")
        press(other, "Add another phone")
        link = other.page.locator("p.key").inner_text()
        other.page.goto(link)
        other.page.get_by_label("A name for this phone").fill("the thief's")
        press(other, "Set up this phone")
        expect(other.page.locator("[data-digits]")).not_to_be_empty()
        other.agree(agrees=has_passkey)
        other.open("/phones")
        press(other, "They are the same: add it", other.page.locator("section.card").first)
        expect(other.page.locator("[data-problem]:visible").first).not_to_be_empty()
        other.page.context.clear_cookies()
        other.agree(agrees=True)
        other.open("/login")
        press(other, "Log in with this phone")
        expect(other.page.locator("[data-problem]:visible")).not_to_be_empty()
        assert other.cookies() == {}
    assert site.run("console", "phones", "--json") == phones


@pytest.mark.attack("stolen-console-session")
@pytest.mark.parametrize(
    ("page", "fields", "button"),
    [
        ("/invite", {"pattern": "/**"}, "Make it"),
        ("/delegate", {}, "Let it renew"),
        ("/revoke/node/master", {"name": "/master"}, "Revoke it"),
    ],
    ids=["join code", "delegation", "master"],
)
def test_a_stolen_cookie_makes_nothing_that_a_phone_has_to_approve(
    chromium: Chromium, owner: Window, site: ConsoleSite, page: str, fields: dict[str, str], button: str
) -> None:
    before = site.run("console", "approvals"), site.run("ca", "invitations", "--all")
    with thief(chromium, owner) as other:
        other.open(page)
        for name, text in fields.items():
            other.page.locator(f"input[name={name}]").fill(text)
        press(other, button)
        expect(other.page.locator("[data-problem]:visible")).not_to_be_empty()
        assert other.page.url == site.origin + page
    assert (site.run("console", "approvals"), site.run("ca", "invitations", "--all")) == before


@pytest.mark.attack("stolen-console-session")
def test_a_stolen_cookie_ends_with_the_session(chromium: Chromium, owner: Window, site: ConsoleSite) -> None:
    with thief(chromium, owner) as other:
        other.open("/who")
        assert other.page.url == site.origin + "/who"
        owner.open("/phones")
        press(owner, "Log out")
        other.open("/who")
        assert other.page.url == site.origin + "/login"
    log_in(owner)
