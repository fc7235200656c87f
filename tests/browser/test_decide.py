"""Deciding: a question approved coarser, one denied; three ticks; a locked key."""

import re

import pytest
from playwright.sync_api import expect

from tests.support.browser import Chromium, Window
from tests.support.consolesite import ASKED, CAMERA, POSE, ConsoleSite
from tests.support.pagecheck import PageCheck
from tests.support.person import press, thief

pytestmark = pytest.mark.browser
ANSWER = re.compile("^Today")


def ask(site: ConsoleSite, node: str, topic: str, why: str) -> None:
    site.run("grant", "request", node, "--subscribe", topic, "--why", why)


def open_question(phone: Window) -> None:
    phone.open("/")
    phone.page.get_by_role("link", name="Look at it").first.click()
    phone.page.wait_for_url(re.compile("/ask/"))


def test_the_first_page_says_that_nothing_waits(phone: Window, site: ConsoleSite, check: PageCheck) -> None:
    site.write_policy(ASKED)
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
    expect(phone.page.locator(".look svg")).to_have_count(2)  # what it asks for, and coarser
    phone.page.locator("input[value=coarse-position]").check()
    press(phone, ANSWER)
    phone.page.wait_for_url(lambda url: "/ask/" not in url)
    assert "/lamp" in site.run("grant", "list")
    check(phone, "ask-approved", "phone")
    phone.open("/see/robot/pose")
    expect(phone.page.locator("main")).to_contain_text("where it is: the room")  # /lamp's
    check(phone, "see", "phone", "desktop")


def test_a_question_is_denied_without_the_passkey(
    chromium: Chromium, phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    ask(site, "/lamp", CAMERA, "to see who is there")
    with thief(chromium, phone) as other:
        open_question(other)
        press(other, "Deny")
        expect(other.page.locator("h1")).to_have_text("Denied")
        check(other, "asked")
    assert CAMERA not in site.run("grant", "list", "/lamp")


def test_what_ended_is_ticked_off_as_it_comes_true(
    phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    open_grant(phone)
    check(phone, "grant", "phone")
    phone.page.get_by_label(re.compile("^Why")).fill("the visit is over")
    press(phone, "End it now")
    phone.page.wait_for_url(re.compile("/revoked/"))
    expect(phone.page.locator("li.tick.is-done")).to_have_count(3, timeout=30_000)
    expect(phone.page.locator("h1")).to_contain_text(re.compile("no longer|has ended"))
    expect(phone.page.locator("ul.ticks")).to_contain_text(re.compile(r"(\d+) of \1 nodes have it"))
    check(phone, "revoked", "phone")


def open_grant(phone: Window, topic: str = CAMERA) -> None:
    phone.open(f"/see{topic}")
    phone.page.get_by_role("link", name="all of it").first.click()
    phone.page.wait_for_url(re.compile("/grant/"))


def test_a_node_is_revoked_by_its_typed_name(phone: Window, site: ConsoleSite, check: PageCheck) -> None:
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
    expect(phone.page.locator("main .lead")).to_contain_text("Its identity is valid until")


def test_what_is_approved_while_the_key_is_locked_waits_for_it(
    phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    ask(site, "/heating", CAMERA, "to see who is cold")
    site.run("ca", "lock")
    phone.open("/")
    check(phone, "today-locked", "phone-dark")
    open_question(phone)
    press(phone, ANSWER)
    expect(phone.page.locator("h1")).to_have_text("Approved. The key is locked")
    check(phone, "approved-locked", "phone")
    assert CAMERA not in site.run("grant", "list", "/heating")
    site.run("ca", "unlock", *site.key)
    expect(phone.page.locator("h1")).to_have_text("Done", timeout=30_000)  # by itself
    check(phone, "approved-done", "phone")
    assert CAMERA in site.run("grant", "list", "/heating")


def test_what_is_ended_while_the_key_is_locked_waits_for_it(
    phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    site.run("ca", "lock")
    open_grant(phone, POSE)
    press(phone, "End it now")
    expect(phone.page.locator("main")).to_contain_text("It is recorded.")
    expect(phone.page.locator("li.tick.is-done")).to_have_count(0)
    check(phone, "revoked-locked", "phone")
    site.run("ca", "unlock", *site.key)
    expect(phone.page.locator("li.tick.is-done").first).to_contain_text("signed, list")
