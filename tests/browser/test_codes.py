"""Codes as a person meets them: used up, expired, for anonymous nodes, while the key is locked."""

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import expect

from tests.support.browser import Chromium, Window
from tests.support.consolesite import ConsoleSite, console_site
from tests.support.pagecheck import PageCheck
from tests.support.person import code_of, heading, press

pytestmark = pytest.mark.browser

LIFETIME = 3.0  # seconds of a code from the terminal here


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ConsoleSite]:
    """An authority whose codes end soon, and a console; no master."""
    with console_site(tmp_path_factory.mktemp("site")) as site:
        site.start_authority(code_lifetime=LIFETIME)
        site.start_console()
        yield site


def make_code(phone: Window, names: str, *, anonymous: bool = False) -> None:
    phone.open("/invite")
    phone.page.get_by_label(re.compile("For which names")).fill(names)
    if anonymous:
        phone.page.get_by_label("for anonymous nodes too").check()
    press(phone, "Make it")
    expect(phone.page.locator("h1")).not_to_have_text("Join codes")


def join(site: ConsoleSite, host: str, text: str, *options: str, code: int = 0) -> str:
    """What `rossec node join` says on another computer."""
    environ = site.elsewhere(host)
    path = site.root / "elsewhere" / host / "code"
    path.touch(0o600)
    path.write_text(text + "\n")
    return site.run("node", "join", "--file", str(path), *options, environ=environ, code=code)


def test_a_code_of_the_terminal_that_has_expired_says_what_to_do(
    chromium: Chromium, site: ConsoleSite, check: PageCheck
) -> None:
    """By both of its buttons: the page was open for too long."""
    code = code_of(site)
    with chromium.window(site.origin) as window:
        window.open(f"/login#{code}")
        window.page.wait_for_timeout(LIFETIME * 1000 + 200)
        press(window, "Set up this phone")
        problem = window.page.locator("[data-problem]:visible")
        expect(problem).to_contain_text("not valid, or not any more")
        expect(problem).to_contain_text("rossec console phone")
        check(window, "login-expired", "phone")
        press(window, "Only look")
        expect(window.page.locator("p.problem:visible")).to_contain_text("rossec console phone")
        assert heading(window) == "Who is there?"
        assert window.cookies() == {}
        window.forgive("403")


def test_a_join_code_for_anonymous_nodes_too(phone: Window, site: ConsoleSite, check: PageCheck) -> None:
    make_code(phone, "/rviz", anonymous=True)
    text = phone.page.locator("#text").inner_text()
    assert text.startswith("ROSSEC")
    join(site, "desk", text)
    phone.open("/invite")
    expect(phone.page.locator("main")).to_contain_text("/rviz")
    check(phone, "invite-used", "phone")
    phone.open("/node/rviz")
    expect(phone.page.locator(".lead")).to_contain_text("nodes whose name begins with it")


def test_a_join_code_that_is_used_up_takes_no_second_node(phone: Window, site: ConsoleSite) -> None:
    make_code(phone, "/garden/*")
    text = phone.page.locator("#text").inner_text()
    join(site, "gate", text, "--name", "/garden/gate")
    said = join(site, "thief", text, "--name", "/garden/thief", code=1)
    assert "hint: " in said
    phone.open("/invite")
    expect(phone.page.locator("main")).to_contain_text("/garden/gate")
    expect(phone.page.locator("main")).not_to_contain_text("/garden/thief")
    assert "/garden/thief" not in site.run("ca", "list")


def test_a_join_code_that_has_expired_is_over(phone: Window, site: ConsoleSite) -> None:
    text = site.run("ca", "invite", "/cellar", "--for", "1s").splitlines()[-1]
    phone.page.wait_for_timeout(2100)
    phone.open("/invite")
    over = phone.page.locator("section", has=phone.page.get_by_role("heading", name="Over"))
    expect(over.locator("li", has_text="/cellar")).to_contain_text("expired")
    said = join(site, "cellar", text, code=1)
    assert "expired" in said
    assert "hint: " in said


@pytest.mark.parametrize("names", ["/a b", "/ca", "no-slash"])
def test_names_that_no_node_can_have_are_refused_in_the_form(phone: Window, names: str) -> None:
    phone.open("/invite")
    phone.page.get_by_label(re.compile("For which names")).fill(names)
    phone.page.get_by_label("for anonymous nodes too").check()
    press(phone, "Make it")
    expect(phone.page.locator("[data-problem]:visible")).not_to_be_empty()
    assert heading(phone) == "Join codes"
    phone.forgive("422")


def test_a_code_is_made_while_the_key_is_locked_and_its_node_waits(phone: Window, site: ConsoleSite) -> None:
    """The code needs no signature; the node that joins by it does, and asks again."""
    site.run("ca", "lock")
    make_code(phone, "/attic")
    text = phone.page.locator("#text").inner_text()
    assert "rossec ca unlock" in join(site, "attic", text, code=5)
    site.run("ca", "unlock", "--for", "0", *site.key)
    join(site, "attic", text)
    phone.open("/node/attic")
    expect(phone.page.locator(".lead")).to_contain_text("Its identity is valid until")
