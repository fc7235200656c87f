"""What a page says of an answer is what is in force: given, denied, forbidden, ending."""

import re

import pytest
from playwright.sync_api import expect

from tests.support.browser import Window
from tests.support.consolesite import ASKED, CAMERA, POSE, ConsoleSite
from tests.support.pagecheck import PageCheck
from tests.support.person import press

pytestmark = pytest.mark.browser

ACTS = "It would act, not only look."
TITLES = """
title:
  /doctor: Dr. Meier
  /lamp: the lamp in the hall
  /robot: the robot
  /robot/pose: where the robot is
"""
POST = """([path, fields]) => fetch(path, {
    method: "POST", headers: {Accept: "application/json"}, body: new URLSearchParams(fields)
}).then(answer => answer.json().then(said => [answer.status, said.error]))"""


LINKS = """() => {
    const links = [...document.querySelectorAll("main a")]
        .filter(link => link.textContent.trim() === "Look at it");
    return links.length === %d ? links.map(link => link.getAttribute("href")) : null;
}"""
ENDED = """() => document.querySelector("h1")
    && document.querySelectorAll("main b.ended").length"""


def questions(phone: Window, number: int) -> list[str]:
    """The addresses of so many questions, oldest first."""
    phone.open("/")
    links: list[str] = phone.read(LINKS % number)
    return links


def test_a_request_for_two_rights_is_two_questions_and_driving_looks_different(
    phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    site.write_policy(ASKED + TITLES)
    site.enroll("/lamp")
    rights = ("--subscribe", CAMERA, "--publish", "/cmd_vel")
    site.run("grant", "request", "/lamp", *rights, "--why", "to follow the cat")
    found = questions(phone, 2)
    check(phone, "today-two-questions", "phone")
    told = {}
    for path in found:
        phone.open(path)
        text = phone.page.locator("main").inner_text()
        told[text] = ACTS in text
        check(phone, "ask-drive" if told[text] else "ask-look", "phone")
    (drive,) = [text for text, acts in told.items() if acts]
    (look,) = [text for text, acts in told.items() if not acts]
    assert "drive: send commands to /cmd_vel" in drive
    assert "the lamp in the hall /lamp wants to see" in look


def test_denying_one_of_them_says_denied_and_leaves_the_other(
    phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    for path in questions(phone, 2):
        phone.open(path)
        if ACTS in phone.page.locator("main").inner_text():
            break
    expect(phone.page.locator("form[data-approve]")).to_contain_text("no coarser form of it")
    press(phone, "Deny")
    expect(phone.page.locator("h1")).to_have_text("Denied")
    expect(phone.page.locator("main")).to_contain_text("/lamp may not send /cmd_vel")
    check(phone, "asked-denied", "phone")
    (other,) = questions(phone, 1)
    phone.open(other)
    expect(phone.page.locator("h1")).to_contain_text(CAMERA)
    expect(phone.page.locator("form[data-approve]")).to_contain_text("does not say of which type")
    press(phone, "Deny")


def test_after_an_unconfirmed_finger_nothing_forbidden_becomes_possible(
    phone: Window, site: ConsoleSite
) -> None:
    site.run("grant", "request", "/lamp", "--subscribe", POSE, "--why", "to light the room")
    (path,) = questions(phone, 1)
    phone.open(path)
    month = phone.page.locator("button[value=month]")
    expect(month).to_be_disabled()
    phone.agree(agrees=False)
    press(phone, re.compile("^Today"))
    expect(phone.page.locator("[data-problem]:visible")).to_contain_text("not confirmed")
    expect(phone.page.locator("button[value=today]")).to_be_enabled()
    expect(month).to_be_disabled()
    phone.agree(agrees=True)
    question = phone.page.locator("input[name=question]").input_value()
    fields = {"question": question, "coarse": "", "duration": "month"}
    status, said = phone.page.evaluate(POST, ["/prepare/grant", fields])
    assert (status, said) == (422, "the policy allows 7 days at most")
    phone.forgive("422")


def test_the_narrowest_is_chosen_and_what_was_given_is_told(
    phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    (path,) = questions(phone, 1)
    phone.open(path)
    chosen = phone.page.locator("input[name=coarse]:checked")
    assert chosen.input_value() == "presence-only"
    phone.page.locator("input[value=coarse-position]").check()
    press(phone, re.compile("^For a week"))
    phone.page.wait_for_url(re.compile("/approved/"))
    expect(phone.page.locator("h1")).to_have_text("Done")
    main = phone.page.locator("main")
    expect(main).to_contain_text("the lamp in the hall /lamp may now see")
    expect(main).to_contain_text("where it is: the room")
    expect(main).to_contain_text(re.compile(r"until \d+ \w+ \d{4}, \d\d:\d\d"))
    expect(main).not_to_contain_text("asked for")
    check(phone, "approved-coarse", "phone")


def test_a_name_typed_without_its_slash_is_the_name_and_another_leaves_the_field(
    phone: Window, check: PageCheck
) -> None:
    phone.open("/revoke/node/lamp")
    phone.page.get_by_label("Type its name").fill("lamb")
    press(phone, "Revoke it")
    expect(phone.page.locator("div.problem")).to_contain_text("the name is /lamp")
    check(phone, "revoke-typed-wrong", "phone")
    phone.page.get_by_label("Type its name").fill("lamp")
    press(phone, "Revoke it")
    phone.page.wait_for_url(re.compile("/revoked/"))
    phone.forgive("422")


def ended(phone: Window, path: str) -> int:
    """How many things a page says to have ended."""
    phone.open(path)
    number: int = phone.read(ENDED)
    return number


def test_nothing_has_ended_before_every_node_has_heard(
    phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    """The master is away: the doctor still sees the camera, and no page says anything else."""
    phone.open("/")
    gone = phone.page.locator("main b.ending")
    expect(gone).to_have_count(0, timeout=60_000)  # what was removed before this test
    pages = ("/", "/who", f"/see{CAMERA}", "/way", "/node/doctor")
    before = {path: ended(phone, path) for path in pages}
    phone.open(f"/see{CAMERA}")
    phone.page.get_by_role("link", name="all of it").first.click()
    phone.page.wait_for_url(re.compile("/grant/"))
    site.master.stop()
    press(phone, "End it now")
    phone.page.wait_for_url(re.compile("/revoked/"))
    for path in pages:
        assert ended(phone, path) == before[path]
        expect(phone.page.locator("main b.ending").first).to_be_attached()
    phone.open("/")
    expect(phone.page.locator("main")).not_to_contain_text("Nobody else can.")
    check(phone, "today-ending", "phone", "desktop")
    phone.open("/privacy")
    expect(phone.page.locator("main")).to_contain_text("until every node has heard")
    phone.open("/")
    site.start_master()
    later = phone.page.locator("main b.ended")
    expect(later).to_have_count(before["/"] + 1, timeout=60_000)  # by itself
    expect(phone.page.locator("main b.ending")).to_have_count(0)
    expect(phone.page.locator("main")).to_contain_text("Nobody else can.")
