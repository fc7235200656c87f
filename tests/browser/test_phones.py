"""The first phone by a code, logging in with it, a second one by a link; what a code is not."""

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import expect

from tests.support.browser import Chromium, Window
from tests.support.consolesite import ConsoleSite, console_site
from tests.support.pagecheck import PageCheck
from tests.support.person import code_of, heading, log_in, press, set_up

pytestmark = pytest.mark.browser
DIGITS = re.compile(r"^\d{3}\s?\d{3}$")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ConsoleSite]:
    """An authority and a console: no node is needed to log in."""
    with console_site(tmp_path_factory.mktemp("site")) as site:
        site.start_authority()
        site.start_console()
        yield site


@pytest.fixture(scope="module")
def first(chromium: Chromium, site: ConsoleSite) -> Iterator[Window]:
    """The first phone."""
    with chromium.window(site.origin) as window:
        yield window


def test_a_stranger_is_asked_who_is_there(first: Window, check: PageCheck) -> None:
    first.open("/")
    assert first.page.url == first.origin + "/login"
    check(first, "login", "phone", "desktop")


def test_the_first_phone_is_set_up_by_a_code_of_the_terminal(
    first: Window, site: ConsoleSite, check: PageCheck
) -> None:
    first.open(f"/login#{code_of(site)}")
    expect(first.page).to_have_url(first.origin + "/login")  # without the code
    assert not first.page.get_by_label("The code").is_visible()
    check(first, "login-with-code")
    first.page.get_by_label("A name for this phone").fill("Ada's phone")
    press(first, "Set up this phone")
    first.page.wait_for_url(first.origin + "/")
    first.open("/phones")
    expect(first.page.locator("main")).to_contain_text("You are logged in with Ada's phone.")
    check(first, "phones")


def test_it_logs_in_with_its_passkey(first: Window) -> None:
    first.open("/phones")
    press(first, "Log out")
    first.open("/who")
    assert first.page.url == first.origin + "/login"
    log_in(first)
    first.open("/who")
    assert first.page.url == first.origin + "/who"


def test_a_login_that_the_person_does_not_confirm_is_none(first: Window) -> None:
    first.open("/phones")
    press(first, "Log out")
    first.agree(agrees=False)
    press(first, "Log in with this phone")
    expect(first.page.locator("[data-problem]:visible")).to_have_text(
        "It was not confirmed, so nothing was done. Try it again."
    )
    first.agree(agrees=True)
    log_in(first)


def test_a_code_is_used_once(chromium: Chromium, site: ConsoleSite, check: PageCheck) -> None:
    code = code_of(site)
    with chromium.window(site.origin) as one, chromium.window(site.origin) as other:
        one.open(f"/login#{code}")
        press(one, "Only look")
        one.page.wait_for_url(site.origin + "/")
        other.open(f"/login#{code}")
        press(other, "Set up this phone")
        expect(other.page.locator("[data-problem]:visible")).to_contain_text("code")
        assert heading(other) == "Who is there?"
        other.forgive("403")
        check(other, "login-refused")


def test_a_second_phone_is_added_by_the_first(
    chromium: Chromium, first: Window, site: ConsoleSite, check: PageCheck
) -> None:
    first.open("/phones")
    press(first, "Add another phone")
    link = first.page.locator("p.key").inner_text()
    check(first, "phone-link")
    with chromium.window(site.origin) as second:
        second.page.goto(link)
        check(second, "propose")
        second.page.get_by_label("A name for this phone").fill("Ben's phone")
        press(second, "Set up this phone")
        expect(second.page.locator("[data-digits]")).to_have_text(DIGITS)
        check(second, "propose-digits")
        first.open("/phones")
        shown = first.page.locator(".digits").inner_text()
        assert shown == second.page.locator("[data-digits]").inner_text()
        check(first, "phones-proposal")
        press(first, "They are the same: add it")
        expect(first.page.locator("main")).to_contain_text("Ben's phone")
        second.page.get_by_role("link", name="It is approved: log in").click()
        press(second, "Log in with this phone")
        second.page.wait_for_url(site.origin + "/")
        second.open("/phones")
        expect(second.page.locator("main")).to_contain_text("with Ada's phone")


def test_a_phone_that_is_removed_logs_in_no_more(
    chromium: Chromium, first: Window, site: ConsoleSite
) -> None:
    with chromium.window(site.origin) as third:
        set_up(third, site, "Eve's phone")
        first.open("/phones")
        press(first, "Remove Eve's phone")
        third.open("/")
        assert third.page.url == site.origin + "/login"
        third.faults = [f for f in third.faults if "/news" not in f]  # asked in between, and 401
        press(third, "Log in with this phone")
        expect(third.page.locator("[data-problem]:visible")).not_to_be_empty()
        assert heading(third) == "Who is there?"
