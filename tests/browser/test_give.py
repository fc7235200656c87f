"""Rules that last: the policy, join codes, who else renews and signs; and all that only shows."""

import base64
import re
from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.support.browser import DESKTOP, Chromium, Window
from tests.support.consolesite import ASKED, SCAN, ConsoleSite
from tests.support.pagecheck import PageCheck
from tests.support.person import heading, press
from tests.support.ports import free_port

pytestmark = pytest.mark.browser

POLICY = ASKED.replace(
    "rules: []",
    """identities:
  heating: {node: /heating}
rules:
  - id: heating-scans
    why: walls say where the rooms are
    who: heating
    allow: {subscribe: [/robot/scan]}""",
)


def test_without_a_policy_nothing_is_asked(phone: Window, site: ConsoleSite, check: PageCheck) -> None:
    phone.open("/policy")
    expect(phone.page.locator("h1")).to_have_text("There is no policy")
    check(phone, "no-policy")
    site.write_policy("rossec: 1")
    phone.open("/")
    expect(phone.page.locator("main")).to_contain_text("The policy cannot be used.")
    check(phone, "today-policy-mistakes")
    phone.open("/policy")
    expect(phone.page.locator("h1")).to_have_text("The policy has mistakes")
    check(phone, "policy-mistakes")
    site.write_policy(ASKED)


def test_a_join_code_is_made_shown_once_used_and_ended(
    phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    phone.open("/invite")
    phone.page.get_by_label(re.compile("For which names")).fill("/kitchen/*")
    phone.page.get_by_label("How many nodes?").fill("2")
    press(phone, "Make it")
    text = phone.page.locator("#text").inner_text()
    check(phone, "invited", "phone")
    kettle = site.elsewhere("kettle")
    code = site.root / "code"
    code.touch(0o600)
    code.write_text(text + "\n")
    name = ("--name", "/kitchen/kettle")
    site.run("node", "join", "--file", str(code), *name, environ=kettle)
    phone.page.get_by_role("link", name="I have it").click()
    expect(phone.page.locator("main")).to_contain_text("/kitchen/kettle")
    check(phone, "invite", "phone")
    phone.back()
    expect(phone.page.locator("#text")).to_have_count(0)
    phone.open("/invite")
    press(phone, "End it")
    expect(phone.page.locator("main")).to_contain_text("None: nodes are added one by one.")
    toaster = site.elsewhere("toaster")
    late = ("--name", "/kitchen/toaster")
    site.run("node", "join", "--file", str(code), *late, environ=toaster, code=1)


def test_a_policy_is_shown_as_what_it_changes_and_applied(
    phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    phone.open("/policy")
    expect(phone.page.locator("h1")).to_have_text("All is as the policy says")
    site.write_policy(POLICY)
    phone.open("/policy")
    expect(phone.page.locator("h1")).to_have_text("The policy has changed")
    check(phone, "policy", "phone")
    press(phone, "Apply all of it")
    phone.page.wait_for_url(lambda url: "/policy" not in url)
    check(phone, "policy-applied", "phone")
    phone.open("/see/robot/scan")
    expect(phone.page.locator("main")).to_contain_text("/heating")
    assert SCAN in site.run("grant", "list")


def test_the_master_may_renew(phone: Window, site: ConsoleSite, check: PageCheck) -> None:
    phone.open("/delegate")
    check(phone, "delegate")
    phone.page.get_by_label("For how many days?").fill("30")
    press(phone, "Let it renew")
    expect(phone.page.locator("h1")).to_have_text("Done")
    check(phone, "delegated")


def test_another_host_signs(phone: Window, site: ConsoleSite, check: PageCheck) -> None:
    """Its request is pasted, its fingerprint compared, and its bundle carried back."""
    host = site.elsewhere("cellar")
    said = site.run("ca", "intermediate", "request", site.domain, *site.key, environ=host)
    found = re.search(r"^request of an intermediate of \S+: (.+)$", said, re.MULTILINE)
    assert found is not None
    path = Path(found[1])
    phone.open("/intermediate")
    check(phone, "intermediate")
    phone.page.get_by_label(re.compile("^The request")).fill(base64.encodebytes(path.read_bytes()).decode())
    press(phone, "Go on")
    assert heading(phone) == "Is this its fingerprint?"
    check(phone, "intermediate-fingerprint")
    press(phone, "It is the same: let it sign")
    bundle = phone.page.get_by_label(re.compile("^Copy this"))
    expect(bundle).to_be_visible()
    check(phone, "intermediate-signed")
    signed = path.with_suffix(".pem")
    signed.write_text(bundle.input_value())
    said = site.run("ca", "intermediate", "install", str(signed), *site.key, environ=host)
    assert "this host may renew until" in said


@pytest.mark.parametrize("path", ["/who", "/way", "/log", "/privacy"])
def test_the_other_pages(phone: Window, check: PageCheck, path: str) -> None:
    phone.open(path)
    check(phone, path.strip("/"), "phone", "desktop")


@pytest.mark.parametrize(
    ("state", "path"), [("no-page", "/nothing"), ("no-node", "/node/nobody"), ("no-topic", "/see/nothing")]
)
def test_what_does_not_exist_is_said_so(phone: Window, check: PageCheck, state: str, path: str) -> None:
    phone.open(path)
    check(phone, state)
    phone.faults = [fault for fault in phone.faults if "404" not in fault]


def test_a_screen_on_the_wall_only_shows(chromium: Chromium, site: ConsoleSite, check: PageCheck) -> None:
    port = free_port()
    options = ("console", "--read-only", "--port", str(port))
    wall = site.begin("rossec", *options, log="wall")
    code = wall.said(r"/login#(\S+)")[1]
    with chromium.window(f"http://localhost:{port}", size=DESKTOP) as screen:
        screen.open(f"/login#{code}")
        press(screen, "Look")
        screen.page.wait_for_url(screen.origin + "/")
        check(screen, "wall", "desktop-dark")
        assert screen.page.locator("main form").count() == 0
        screen.open("/phones")
        expect(screen.page.locator("main")).to_contain_text("This console only shows.")
        check(screen, "wall-phones")
        screen.open("/add")
        assert heading(screen) == "That did not work"
        screen.forgive("404")
