"""Adding a node: its code by the camera, as a picture, as text; the card, the digits, the end."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from PIL import Image
from playwright.sync_api import expect

from tests.support.browser import Chromium, Window
from tests.support.consolesite import ConsoleSite, Program, console_site
from tests.support.pagecheck import PageCheck
from tests.support.person import heading, press

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ConsoleSite]:
    """An authority that knows the heating, and a console; no master is needed to enroll."""
    with console_site(tmp_path_factory.mktemp("site")) as site:
        site.start_authority()
        site.enroll("/heating")
        site.start_console()
        yield site


class NewNode:
    """A node on another computer that shows its code and waits."""

    def __init__(self, site: ConsoleSite, name: str, host: str = "") -> None:
        self.site, self.name = site, name
        self.environ = site.elsewhere(host or name.strip("/"))
        self.picture = Path(self.environ["ROSSEC_HOME"]) / f"{name.strip('/')}.png"
        options = ("--address", "127.0.0.1", "--png", str(self.picture))
        self.program: Program = site.begin(
            "rossec", "node", "enroll", name, *options, log=f"{host}{name.strip('/')}", **self.environ
        )
        self.code = self.program.said(r"ROSSEC:.*\S")[0]
        self.program.said("waits at")

    def confirm(self, digits: str) -> None:
        """The person at the node has compared the digits."""
        assert digits.replace(" ", "") in self.program.said(r"^digits ([\d ]+)$")[1].replace(" ", "")
        self.site.run("node", "confirm", self.name, digits.replace(" ", ""), environ=self.environ)


def approve(phone: Window, label: str = "Approve") -> str:
    """Approve on the card; the digits that are shown then."""
    press(phone, label)
    digits = phone.page.locator("p.digits")
    expect(digits).to_be_visible()
    return digits.inner_text()


def test_a_camera_that_sees_no_code_goes_on(phone: Window, check: PageCheck) -> None:
    phone.open("/add")
    press(phone, "Scan with the camera")
    expect(phone.page.locator("video")).to_be_visible()
    check(phone, "add-camera")


def test_by_the_camera(chromium: Chromium, phone: Window, site: ConsoleSite, check: PageCheck) -> None:
    node = NewNode(site, "/fridge")
    with Image.open(node.picture) as picture:
        chromium.camera.show(picture)
    phone.open("/add")
    check(phone, "add", "phone")
    press(phone, "Scan with the camera")
    expect(phone.page.locator("h1")).to_have_text("A node asks to join")
    expect(phone.page.locator(".big")).to_have_text("/fridge")
    check(phone, "add-card", "phone", "phone-dark")
    digits = approve(phone)
    check(phone, "add-digits", "phone")
    assert "enrolled" not in node.program.log.read_text(), "before anybody compared"
    node.confirm(digits)
    expect(phone.page.locator("h1")).to_have_text("/fridge is enrolled")
    check(phone, "add-enrolled", "phone")
    assert node.program.ended() == 0


def test_by_a_picture_of_the_code(phone: Window, site: ConsoleSite) -> None:
    node = NewNode(site, "/lamp")
    phone.open("/add")
    phone.page.get_by_label("or a picture of it").set_input_files(node.picture)
    expect(phone.page.locator(".big")).to_have_text("/lamp")
    node.confirm(approve(phone))
    expect(phone.page.locator("h1")).to_have_text("/lamp is enrolled")


def test_a_picture_without_a_code_says_so(phone: Window, tmp_path: Path, check: PageCheck) -> None:
    empty = tmp_path / "empty.png"
    Image.new("RGB", (300, 300), "white").save(empty)
    phone.open("/add")
    phone.page.get_by_label("or a picture of it").set_input_files(empty)
    expect(phone.page.locator("[data-picture-problem]")).to_contain_text("no code")
    check(phone, "add-no-code")


def test_by_the_text_and_rejected(phone: Window, site: ConsoleSite, check: PageCheck) -> None:
    node = NewNode(site, "/toaster")
    paste(phone, node.code)
    expect(phone.page.locator(".big")).to_have_text("/toaster")
    press(phone, "Reject")
    expect(phone.page.locator("h1")).to_have_text("Rejected")
    check(phone, "add-rejected")
    assert "/toaster" not in site.run("ca", "list")


def test_digits_that_differ_end_it_at_the_authority_too(
    phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    """Whoever is in between confirms at the node: what was signed is accepted by nobody."""
    node = NewNode(site, "/kettle")
    paste(phone, node.code)
    digits = approve(phone)
    assert "/kettle" in site.run("ca", "list")
    press(phone, "They differ: stop it")
    expect(phone.page.locator("h1")).to_have_text("Stopped: the digits differed")
    expect(phone.page.locator("main")).to_contain_text("is revoked: nothing accepts it")
    check(phone, "add-differed", "phone")
    assert digits
    assert "/kettle" not in site.run("ca", "list")
    phone.open("/node/kettle")
    expect(phone.page.locator("main .lead")).to_contain_text("the digits differed")
    node.program.stop()


def test_a_text_that_is_no_code_is_refused(phone: Window, check: PageCheck) -> None:
    paste(phone, "ROSSEC:NOTHING")
    expect(phone.page.locator("[role=alert]:visible")).not_to_be_empty()
    phone.forgive("422")
    check(phone, "add-refused")


def test_a_key_that_changed_is_rejected_unless_its_name_is_typed(
    phone: Window, site: ConsoleSite, check: PageCheck
) -> None:
    """Another computer says that it is the heating."""
    node = NewNode(site, "/heating", "other")
    paste(phone, node.code)
    expect(phone.page.locator("h1")).to_contain_text("CHANGED")
    first = phone.page.locator("main button").first
    assert first.inner_text() == "Reject"
    check(phone, "key-changed", "phone", "phone-dark")
    press(phone, "It was: replace the key")
    assert heading(phone) == "The key of a name you know has CHANGED"
    phone.page.get_by_label(re.compile("type the name")).fill("/doctor")
    press(phone, "It was: replace the key")
    expect(phone.page.locator("[data-problem]:visible")).not_to_be_empty()
    phone.forgive("422")
    phone.page.get_by_label(re.compile("type the name")).fill("/heating")
    node.confirm(approve(phone, "It was: replace the key"))
    expect(phone.page.locator("h1")).to_have_text("/heating is enrolled")
    assert node.program.ended() == 0


def paste(phone: Window, text: str) -> None:
    phone.open("/add")
    phone.page.get_by_label("The text below the code").fill(text)
    press(phone, "Go on")
