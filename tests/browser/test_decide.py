"""Deciding: a question approved coarser, one denied; ended with three ticks; codes; the policy."""

import re

import pytest
from playwright.sync_api import expect

from tests.support.browser import Chromium, Window
from tests.support.consolesite import CAMERA, POSE, SCAN, ConsoleSite
from tests.support.pagecheck import PageCheck
from tests.support.person import press, thief

pytestmark = pytest.mark.browser

ASKED = """
rossec: 1
robot: the robot at home
defaults: {decision: prompt, prompt_timeout: 10m, lifetime: 7d}
rules: []
"""
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


def test_without_a_policy_nothing_is_asked(
    phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    phone.open("/policy")
    expect(phone.page.locator("h1")).to_have_text("There is no policy")
    check(phone, "no-policy")
    write_policy(site, "rossec: 1")
    phone.open("/")
    expect(phone.page.locator("main")).to_contain_text("The policy cannot be used.")
    check(phone, "today-policy-mistakes")
    phone.open("/policy")
    expect(phone.page.locator("h1")).to_have_text("The policy has mistakes")
    check(phone, "policy-mistakes")
    write_policy(site, ASKED)


def write_policy(site: ConsoleSite, text: str) -> None:
    path = site.root / "ca" / "policy.yaml"
    path.touch(0o600)
    path.write_text(text)


def ask(site: ConsoleSite, node: str, topic: str, why: str) -> None:
    site.run("grant", "request", node, "--subscribe", topic, "--why", why)


def open_question(phone: Window) -> None:
    phone.open("/")
    phone.page.get_by_role("link", name="Look at it").first.click()
    phone.page.wait_for_url(re.compile("/ask/"))


def test_the_first_page_says_that_nothing_waits(phone: Window, check: PageCheck) -> None:
    phone.open("/")
    expect(phone.page.locator("h1")).to_have_text("Nothing waits for you")
    check(phone, "today", "phone", "desktop", "desktop-dark")


def test_a_question_is_approved_coarser_and_for_today(
    phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    site.enroll("/lamp")
    phone.open("/")
    ask(site, "/lamp", POSE, "to light the room that the robot is in")
    expect(phone.page.locator("h1")).to_have_text("One thing waits for you")  # by itself
    check(phone, "today-question", "phone")
    open_question(phone)
    expect(phone.page.locator("blockquote")).to_contain_text("to light the room")
    check(phone, "ask", "phone", "desktop")
    coarser = phone.page.locator("input[name=coarse]:not([value=''])")
    if coarser.count():
        coarser.first.check()
    press(phone, re.compile("^Today"))
    phone.page.wait_for_url(lambda url: "/ask/" not in url)
    assert "/lamp" in site.run("grant", "list")
    check(phone, "ask-approved", "phone")
    phone.open("/see/robot/pose")
    expect(phone.page.locator("main")).to_contain_text("/lamp")


def test_a_question_is_denied_without_the_passkey(
    chromium: Chromium, phone: Window, site: ConsoleSite
) -> None:
    ask(site, "/lamp", CAMERA, "to see who is there")
    with thief(chromium, phone) as other:
        open_question(other)
        press(other, "Deny")
        expect(other.page.locator("h1")).to_have_text("This is answered")
    assert CAMERA not in site.run("grant", "list").partition("/lamp")[2].partition("\n/")[0]


def test_what_ended_is_ticked_off_as_it_comes_true(
    phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    phone.open("/see/robot/camera")
    phone.page.get_by_role("link", name="all of it").first.click()
    phone.page.wait_for_url(re.compile("/grant/"))
    check(phone, "grant", "phone")
    phone.page.get_by_label(re.compile("^Why")).fill("the visit is over")
    press(phone, "End it now")
    phone.page.wait_for_url(re.compile("/revoked/"))
    expect(phone.page.locator("li.tick.is-done")).to_have_count(3, timeout=30_000)
    expect(phone.page.locator("h1")).to_contain_text(re.compile("no longer|has ended"))
    expect(phone.page.locator("ul.ticks")).to_contain_text(re.compile(r"(\d+) of \1 nodes have it"))
    check(phone, "revoked", "phone")


def test_a_node_is_revoked_by_its_typed_name(
    phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    phone.open("/node/lamp")
    check(phone, "node", "phone", "desktop")
    phone.page.get_by_role("link", name="Remove /lamp").click()
    phone.page.get_by_label("Type its name").fill("/lamp")
    check(phone, "revoke-node", "phone")
    press(phone, "Revoke it")
    expect(phone.page.locator("li.tick.is-done")).to_have_count(3, timeout=30_000)
    expect(phone.page.locator("h1")).to_have_text("/lamp is no longer trusted")


def test_the_master_is_revoked_by_the_passkey_alone(
    chromium: Chromium, phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    phone.open("/revoke/node/master")
    check(phone, "revoke-master", "phone")
    with thief(chromium, phone) as other:
        other.open("/revoke/node/master")
        other.page.get_by_label("Type its name").fill("/master")
        press(other, "Revoke it")
        expect(other.page.locator("[data-problem]:visible")).not_to_be_empty()
    phone.open("/node/master")
    expect(phone.page.locator("main .lead")).to_contain_text("Has a name here")


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
    phone.page.go_back()
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
    write_policy(site, POLICY)
    phone.open("/policy")
    expect(phone.page.locator("h1")).to_have_text("The policy has changed")
    check(phone, "policy", "phone")
    press(phone, "Apply all of it")
    phone.page.wait_for_url(lambda url: "/policy" not in url)
    check(phone, "policy-applied", "phone")
    phone.open("/see/robot/scan")
    expect(phone.page.locator("main")).to_contain_text("/heating")
    assert SCAN in site.run("grant", "list")


def test_what_is_approved_while_the_key_is_locked_waits_for_it(
    phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    ask(site, "/heating", CAMERA, "to see who is cold")
    site.run("ca", "lock")
    open_question(phone)
    press(phone, re.compile("^Today"))
    expect(phone.page.locator("h1")).to_have_text("Approved. The key is locked")
    check(phone, "approved-locked", "phone")
    assert CAMERA not in site.run("grant", "list").partition("/heating")[2]
    site.run("ca", "unlock", *site.key)
    expect(phone.page.locator("h1")).to_have_text("Done", timeout=30_000)  # by itself
    check(phone, "approved-done", "phone")
    assert CAMERA in site.run("grant", "list")


@pytest.mark.parametrize("path", ["/who", "/way", "/log", "/privacy", "/delegate", "/intermediate"])
def test_the_other_pages(phone: Window, check: PageCheck, path: str) -> None:
    phone.open(path)
    check(phone, path.strip("/"), "phone", "desktop")
