"""What a person does at the console, in a window of a browser."""

import contextlib
import json
import re
from collections.abc import Iterator

from playwright.sync_api import Locator

from tests.support.browser import Chromium, Window
from tests.support.consolesite import ConsoleSite


def code_of(site: ConsoleSite) -> str:
    """A new one-time code, as `rossec console phone` prints it in its link."""
    address: str = json.loads(site.run("console", "phone", "--json"))["login"]
    return address.removeprefix(f"{site.origin}/login#")


def set_up(window: Window, site: ConsoleSite, name: str = "my phone") -> None:
    """Make a passkey with a code from the terminal, and log in by that."""
    window.open(f"/login#{code_of(site)}")
    window.page.get_by_label("A name for this phone").fill(name)
    press(window, "Set up this phone")
    window.page.wait_for_url(site.origin + "/")


def only_look(window: Window, site: ConsoleSite, code: str = "") -> None:
    """Log in by a code from the terminal: without a passkey."""
    window.open(f"/login#{code or code_of(site)}")
    press(window, "Only look")
    window.page.wait_for_url(site.origin + "/")


def log_in(window: Window) -> None:
    """Log in with the window's passkey."""
    window.open("/login")
    press(window, "Log in with this phone")
    window.page.wait_for_url(window.origin + "/")


def press(window: Window, label: str | re.Pattern[str], inside: Locator | None = None) -> None:
    """Press the button that has this label."""
    place = window.page if inside is None else inside
    exact = {"exact": True} if isinstance(label, str) else {}
    place.get_by_role("button", name=label, **exact).click()  # type: ignore[arg-type]


def heading(window: Window) -> str:
    """The page's first heading."""
    return window.page.locator("h1").inner_text()


@contextlib.contextmanager
def thief(chromium: Chromium, window: Window) -> Iterator[Window]:
    """Another browser with the session of `window`: its cookie, and no passkey."""
    with chromium.window(window.origin, checked=False) as other:
        other.put_cookies(window.cookies())
        yield other
