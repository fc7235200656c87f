"""Who else may sign: the master, another host; what waits for the key, or for the master."""

import base64
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.support.browser import Window
from tests.support.consolesite import ConsoleSite, console_site
from tests.support.pagecheck import PageCheck
from tests.support.person import press

pytestmark = pytest.mark.browser

TOPIC = "/hall/light"
SOON = 40_000  # ms within which a page follows what happens
POLICY = """
rossec: 1
robot: the hall
defaults: {decision: prompt, prompt_timeout: 10m, lifetime: 7d}
rules: []
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ConsoleSite]:
    """An authority, its master and a console, without a robot; a node `/lamp` that asks."""
    with console_site(tmp_path_factory.mktemp("site")) as site:
        policy = site.root / "ca" / "policy.yaml"
        policy.touch(0o600)
        policy.write_text(POLICY)
        site.start_authority()
        site.start_master()
        site.enroll("/lamp")
        site.start_console()
        yield site


@pytest.fixture(scope="module")
def host(site: ConsoleSite) -> Path:
    """The directory of another host that has made its request, and the fingerprint beside it."""
    environ = site.elsewhere("second-host")
    said = site.run("ca", "intermediate", "request", site.domain, *site.key, environ=environ)
    found = re.search(r"^fingerprint (.+)$", said, re.MULTILINE)
    assert found is not None
    home = Path(environ["ROSSEC_HOME"])
    (home / "fingerprint").write_text(found[1])
    return home


def paste(phone: Window, text: str) -> None:
    phone.open("/intermediate")
    phone.page.get_by_label(re.compile("^The request")).fill(text)
    press(phone, "Go on")


def hex_of(text: str) -> str:
    return re.sub(r"[^0-9a-f]", "", text.lower())


def open_question(phone: Window) -> None:
    phone.open("/")
    phone.page.get_by_role("link", name="Look at it").first.click()
    phone.page.wait_for_url(re.compile("/ask/"))


def main_of(page: Page) -> str:
    return page.locator("main").inner_text()


def test_the_master_may_renew_what_a_phone_approved(
    phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    phone.open("/delegate")
    phone.page.get_by_label("For how many days?").fill("30")
    phone.page.get_by_label("Each time for").select_option("hour")
    press(phone, "Let it renew")
    expect(phone.page.locator("h1")).to_have_text("Done", timeout=SOON)
    expect(phone.page.locator("main")).to_contain_text("/master may renew grants")
    expect(phone.page.locator("main")).to_contain_text("my phone")
    check(phone, "delegated")
    phone.open("/log")
    expect(phone.page.locator("main")).to_contain_text("that the master renews")
    assert "withdrew 1 delegation" in site.run("master", "delegate", "--withdraw", *site.key)


def test_what_is_no_request_of_a_host_is_refused(phone: Window, check: PageCheck) -> None:
    paste(phone, "this is not it")
    expect(phone.page.locator("[role=alert]:visible")).to_contain_text("not a request of a host")
    phone.forgive("422")
    check(phone, "intermediate-refused")


def test_a_host_of_another_domain_is_refused(phone: Window, site: ConsoleSite) -> None:
    environ = site.elsewhere("foreign-host")
    site.run("ca", "intermediate", "request", "elsewhere", *site.key, environ=environ)
    data = (Path(environ["ROSSEC_HOME"]) / "ca" / "intermediate.csr").read_bytes()
    paste(phone, base64.b64encode(data).decode())
    expect(phone.page.locator("[role=alert]:visible")).not_to_be_empty()
    assert phone.page.get_by_role("button", name="let it sign").count() == 0
    phone.forgive("422")


def test_a_host_signs_after_its_fingerprint_was_approved(
    phone: Window, site: ConsoleSite, host: Path, check: PageCheck
) -> None:
    """Pasted as `base64` prints it: in lines."""
    data = (host / "ca" / "intermediate.csr").read_bytes()
    paste(phone, base64.encodebytes(data).decode())
    expect(phone.page.locator("h1")).to_have_text("Is this its fingerprint?")
    shown = hex_of(phone.page.locator(".big").inner_text())
    assert shown
    assert hex_of((host / "fingerprint").read_text()).startswith(shown)
    check(phone, "intermediate-fingerprint", "phone")
    phone.page.get_by_label("and add new nodes").check()
    press(phone, "It is the same: let it sign")
    expect(phone.page.locator("h1")).to_have_text("Done", timeout=SOON)
    check(phone, "intermediate-bundle", "phone")
    bundle = host / "bundle.pem"
    bundle.write_text(phone.page.locator("#bundle").input_value())
    environ = site.elsewhere("second-host")
    said = site.run("ca", "intermediate", "install", str(bundle), *site.key, environ=environ)
    assert "may renew and enroll until" in said


def test_the_host_adds_a_node_that_the_root_has_not_seen(site: ConsoleSite, host: Path) -> None:
    """What was carried over is the real thing: a node with its signature is taken."""
    assert (host / "ca" / "intermediate.pem").exists()
    environ = site.elsewhere("second-host")
    site.run("node", "request", "/porch", environ=environ)
    request = host / "nodes" / "porch" / "node.csr"
    site.run("ca", "sign", str(request), "--yes", *site.key, environ=environ)
    site.run("node", "install", str(request.with_suffix(".pem")), "--yes", environ=environ)
    assert "/porch" in site.run("ca", "list", environ=environ)
    assert "/porch" not in site.run("ca", "list")


def test_a_grant_that_was_approved_while_locked_is_signed_at_unlock(phone: Window, site: ConsoleSite) -> None:
    site.run("ca", "lock")
    site.run("grant", "request", "/lamp", "--subscribe", TOPIC, "--why", "to know when it is dark")
    open_question(phone)
    press(phone, re.compile("^Today"))
    expect(phone.page.locator("h1")).to_have_text("Approved. The key is locked")
    expect(phone.page.locator("main")).to_contain_text("rossec ca unlock")
    assert TOPIC not in site.run("grant", "list")
    phone.open("/log")
    phone.back()
    site.run("ca", "unlock", "--for", "0", *site.key)
    expect(phone.page.locator("h1")).to_have_text("Done", timeout=SOON)
    assert TOPIC in site.run("grant", "list")


def test_without_a_master_pages_say_what_works_and_what_does_not(
    phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    site.master.stop()
    phone.open("/")
    expect(phone.page.locator("p.notice")).to_be_visible(timeout=SOON)  # by itself
    for path in ("/", "/who", "/way", "/log", f"/see{TOPIC}", "/node/lamp", "/privacy"):
        phone.open(path)
        notice = phone.page.locator("p.notice", has_text="The master does not answer.")
        expect(notice).to_contain_text("you can approve, refuse and end as always")
        for technical in ("Errno", "127.0.0.1", "refused to", str(site.master_port), "rossec."):
            assert technical not in notice.inner_text(), path
    phone.open("/")
    check(phone, "today-without-master", "phone")


def test_what_needs_the_master_waits_for_it(phone: Window, site: ConsoleSite, check: PageCheck) -> None:
    phone.open("/delegate")
    press(phone, "Let it renew")
    expect(phone.page.locator("h1")).to_have_text("Approved. It is not done yet")
    assert "locked" not in main_of(phone.page)
    check(phone, "approved-without-master", "phone")
    site.start_master()
    expect(phone.page.locator("h1")).to_have_text("Done", timeout=SOON)
