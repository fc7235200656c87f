"""Attacks on the console that take a browser or whole processes: sites, users, thieves."""

import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Final

import pytest
from playwright.sync_api import expect

from tests.support.browser import Chromium, Window, running_chromium
from tests.support.consolesite import ConsoleSite, console_site, with_robot
from tests.support.person import code_of, log_in, only_look, press, set_up, thief

pytestmark = pytest.mark.browser

NOBODY: Final = 65534
EVIL: Final = "evil.example"
# What a page of a console could be made to do by a page of another site.
FORM: Final = """<!doctype html><title>A game</title>
<form id=form method=post action="{origin}{path}" enctype="{kind}">
<input name=reason value=gone></form><script>document.forms.form.submit()</script>"""
FRAME: Final = """<!doctype html><title>A game</title><iframe src="{origin}/"></iframe>"""
HOSTILE: Final = "<img src=x onerror=alert(1)>\u202etxt.</p><script>alert(2)</script>"
ASKED: Final = """
rossec: 1
robot: the robot at home
defaults: {decision: prompt, prompt_timeout: 10m}
rules: []
"""
PAGES: Final = ("/", "/who", "/way", "/log", "/node/lamp", "/phones", "/privacy", "/policy")
ASK: Final = """
import http.client, sys
connection = http.client.HTTPConnection("127.0.0.1", int(sys.argv[1]), timeout=10)
try:
    connection.request("GET", "/login", headers={"Host": "localhost:" + sys.argv[1]})
    answer = connection.getresponse()
    print(answer.status, b"Who is there" in answer.read())
except OSError as error:
    print(type(error).__name__)
"""


class OtherSite(BaseHTTPRequestHandler):
    """A page of another site, at every path."""

    page = ""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(self.page.encode())

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def other_port() -> Iterator[str]:
    """The port of another site on this host; `OtherSite.page` is what it shows."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), OtherSite)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield str(server.server_port)
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    """A browser whose name server says that a name of the attacker is this host."""
    folder = tmp_path_factory.mktemp("chromium")
    with running_chromium(folder, f"--host-resolver-rules=MAP {EVIL} 127.0.0.1") as running:
        yield running


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ConsoleSite]:
    with console_site(tmp_path_factory.mktemp("site")) as site:
        site.start_authority()
        site.start_master()
        with_robot(site)
        site.start_console()
        yield site


@pytest.fixture(scope="module")
def owner(chromium: Chromium, site: ConsoleSite) -> Iterator[Window]:
    """The browser of the person, logged in."""
    with chromium.window(site.origin, checked=False) as window:
        set_up(window, site)
        yield window


@pytest.mark.attack("console-csrf")
@pytest.mark.parametrize("kind", ["application/x-www-form-urlencoded", "text/plain"])
@pytest.mark.parametrize("host", ["localhost", "127.0.0.1"])
@pytest.mark.parametrize("path", ["/logout", "/phones/link", "/prepare/invitation"])
def test_a_form_of_another_site_does_nothing(
    owner: Window, other_port: str, site: ConsoleSite, host: str, path: str, kind: str
) -> None:
    """On `localhost` it is the same site to a browser, which sends the session's cookie along."""
    OtherSite.page = FORM.format(origin=site.origin, path=path, kind=kind)
    with owner.page.expect_response(lambda answer: answer.url.endswith(path)) as refused:
        owner.page.goto(f"http://{host}:{other_port}")
    assert refused.value.status == 403
    owner.open("/phones")
    assert owner.page.url.endswith("/phones"), "logged out"


@pytest.mark.attack("console-framed")
def test_a_page_is_not_shown_within_another_site(owner: Window, other_port: str, site: ConsoleSite) -> None:
    """A press on a game is a press on a button below it."""
    OtherSite.page = FRAME.format(origin=site.origin)
    owner.page.goto(f"http://localhost:{other_port}")
    frame = owner.page.frames[-1]
    assert frame.url.startswith("chrome-error:") or not frame.query_selector("button")


@pytest.mark.attack("console-rebinding")
def test_a_name_that_points_here_is_not_the_console(owner: Window, site: ConsoleSite) -> None:
    """DNS rebinding: a site's name leads to the console, so its scripts may read the answers."""
    answer = owner.page.goto(f"http://{EVIL}:{site.port}/login")
    assert answer is not None
    assert answer.status == 421
    assert "Who is there" not in owner.page.content()


@pytest.mark.attack("console-other-user")
def test_another_user_of_the_host_has_no_console(site: ConsoleSite, tmp_path: Path) -> None:
    """Ports of loopback belong to nobody, and cookies do not know ports."""
    ask = ("-I", "-c", ASK, str(site.port))
    mine = subprocess.run([sys.executable, *ask], capture_output=True, text=True, check=True)
    assert mine.stdout == "200 True\n"
    theirs = subprocess.run(
        ["/usr/bin/python3", *ask],
        user=NOBODY,
        group=NOBODY,
        extra_groups=[],
        cwd="/",
        capture_output=True,
        text=True,
        check=True,
    )
    assert theirs.stdout == "403 False\n"


@pytest.mark.attack("console-codes")
def test_a_code_that_was_used_sets_up_no_phone(chromium: Chromium, owner: Window, site: ConsoleSite) -> None:
    """Somebody saw it over a shoulder; whoever is second has nothing."""
    code = code_of(site)
    with chromium.window(site.origin, checked=False) as second:
        only_look(owner, site, code)
        second.open(f"/login#{code}")
        press(second, "Set up this phone")
        expect(second.page.locator("[data-problem]:visible")).to_contain_text("code")
        assert second.cookies() == {}
    log_in(owner)


@pytest.fixture(scope="module")
def question(owner: Window, site: ConsoleSite) -> str:
    """The address of a question whose node gives a hostile reason."""
    policy = site.root / "ca" / "policy.yaml"
    policy.touch(0o600)
    policy.write_text(ASKED)
    site.enroll("/lamp")
    site.run("grant", "request", "/lamp", "--subscribe", "/robot/pose", "--why", HOSTILE)
    owner.open("/")
    owner.page.get_by_role("link", name="Look at it").click()
    owner.page.wait_for_url(re.compile("/ask/"))
    return owner.page.url.removeprefix(site.origin)


@pytest.mark.attack("console-hostile-text")
def test_a_nodes_words_are_text_on_every_page(owner: Window, question: str) -> None:
    owner.faults.clear()
    for path in (question, *PAGES):
        owner.open(path)
        assert owner.page.locator("img[src=x], main script:not([src])").count() == 0, path
        assert "\u202e" not in owner.evaluate_apart("document.documentElement.outerHTML"), path
    assert not owner.faults, owner.faults
    owner.open(question)
    expect(owner.page.locator("blockquote")).to_contain_text("<img src=x onerror=alert(1)>")


@pytest.mark.attack("stolen-console-session")
def test_a_stolen_cookie_approves_and_adds_nothing_and_can_deny(
    chromium: Chromium, owner: Window, site: ConsoleSite, question: str
) -> None:
    """In a browser with a passkey of its own, which nobody has approved."""
    phones = site.run("console", "phones", "--json")
    with thief(chromium, owner) as other:
        other.open(question)
        press(other, re.compile("^Today"))
        expect(other.page.locator("[data-problem]:visible")).not_to_be_empty()
        other.open("/invite")
        other.page.get_by_label(re.compile("For which names")).fill("/**")
        press(other, "Make it")
        expect(other.page.locator("[data-problem]:visible")).not_to_be_empty()
        assert "/lamp" not in site.run("grant", "list")
        assert site.run("console", "phones", "--json") == phones
        other.open(question)
        press(other, "Deny")
        expect(other.page.locator("h1")).to_have_text("Denied")
