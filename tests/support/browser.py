"""A real Chromium; each of its windows has a passkey store, and all a camera that shows a code.

Sites of tests are on `localhost`. A window collects what went wrong in it: script errors, reports
of the content security policy, requests that failed, answers of 500 and above.
"""

import contextlib
import io
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, Literal

from PIL import Image
from playwright.sync_api import (
    Browser,
    BrowserContext,
    CDPSession,
    ConsoleMessage,
    Error,
    Page,
    Request,
    Response,
    sync_playwright,
)
from playwright.sync_api import TimeoutError as NotLoaded

CHROMIUM: Final = shutil.which("chromium") or "/usr/bin/chromium"
PHONE: Final = (390, 844)
DESKTOP: Final = (1120, 800)
NARROW: Final = 360  # CSS pixels of the narrowest phones in use
WAIT_MS: Final = 15_000
_LOAD_MS: Final = 6_000
_OVERTAKEN: Final = ("ERR_ABORTED", "interrupted by another navigation", "Not attached to an active page")
_SCENE: Final = (640, 480)
_FRAMES: Final = 8
_TRIES: Final = 10
# A violation of the policy is an event of the document; not all of them reach the console.
_TELL_VIOLATIONS: Final = """document.addEventListener("securitypolicyviolation", event =>
    console.error("CSP: " + event.violatedDirective + " " + event.blockedURI))"""
_AUTHENTICATOR: Final = {
    "protocol": "ctap2",
    "transport": "internal",
    "hasResidentKey": True,
    "hasUserVerification": True,
    "isUserVerified": True,
    "automaticPresenceSimulation": True,
}

Scheme = Literal["light", "dark"]


class Camera:
    """The file that Chromium plays as a camera; it is read when a page opens the camera."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.show(None)

    def show(self, code: Image.Image | None) -> None:
        """Play some frames of an empty scene and some with `code` in it."""
        empty = Image.new("RGB", _SCENE, (96, 92, 88))
        frames = [empty] * _FRAMES
        if code is not None:
            held = empty.copy()
            side = _SCENE[1] - 80
            held.paste(code.convert("RGB").resize((side, side)), ((_SCENE[0] - side) // 2, 40))
            frames += [held] * (4 * _FRAMES)
        self.path.write_bytes(b"".join(map(_jpeg, frames)))


def _jpeg(frame: Image.Image) -> bytes:
    out = io.BytesIO()
    frame.save(out, "JPEG", quality=90)
    return out.getvalue()


def _again_if_overtaken(navigate: Callable[[], object]) -> None:
    """Go to a page; again, if the old one loads itself again just then, which it does for each change."""
    end = time.monotonic() + WAIT_MS / 1000
    while True:
        try:
            navigate()
        except Error as error:
            if time.monotonic() > end or not any(reason in str(error) for reason in _OVERTAKEN):
                raise
        else:
            return


class Window:
    """One browser profile with one page: its own cookies, its own passkey."""

    def __init__(self, context: BrowserContext, origin: str) -> None:
        self.context, self.origin = context, origin
        self.faults: list[str] = []
        self.sizes: dict[str, int] = {}  # of what the page loaded: URL to bytes
        self.page = self._watched(context.new_page())
        self.devtools: CDPSession = context.new_cdp_session(self.page)
        self._authenticator = ""

    def open(self, path: str) -> Page:
        """Go to a page of the site."""
        self.sizes.clear()
        url = self.origin + path
        # Chromium never begins a navigation if the old page loads itself again in that moment.
        with contextlib.suppress(NotLoaded):
            _again_if_overtaken(lambda: self.page.goto(url, timeout=_LOAD_MS))
            return self.page
        _again_if_overtaken(lambda: self.page.goto(url))
        return self.page

    def read(self, script: str) -> Any:
        """What `script` finds in one look at a whole page, which may load itself again meanwhile.

        The script finds nothing (`null`) until the page has come.
        """
        end = time.monotonic() + WAIT_MS / 1000
        while True:
            with contextlib.suppress(Error):  # the page went away under the script
                self.page.wait_for_load_state("domcontentloaded")
                found = self.page.evaluate(script)
                if found is not None:
                    return found
            assert time.monotonic() < end, f"nothing found: {script}"
            self.page.wait_for_timeout(50)

    def back(self) -> None:
        """Go back to the page before."""
        _again_if_overtaken(self.page.go_back)

    def add_authenticator(self) -> None:
        """Give the page a passkey store, as a phone has; its user agrees to everything."""
        self.devtools.send("WebAuthn.enable")
        answer = self.devtools.send("WebAuthn.addVirtualAuthenticator", {"options": dict(_AUTHENTICATOR)})
        self._authenticator = answer["authenticatorId"]

    def passkeys(self) -> list[dict[str, Any]]:
        """What the authenticator holds, private keys with it."""
        found: list[dict[str, Any]] = self._ask("WebAuthn.getCredentials")["credentials"]
        return found

    def put_passkey(self, passkey: Mapping[str, Any]) -> None:
        """Have the authenticator hold a passkey of another one: a clone."""
        self._ask("WebAuthn.addCredential", credential=dict(passkey))

    def agree(self, *, agrees: bool) -> None:
        """Whether the person verifies themselves from now on."""
        self._ask("WebAuthn.setUserVerified", isUserVerified=agrees)

    def _ask(self, method: str, **arguments: object) -> dict[str, Any]:
        given = {"authenticatorId": self._authenticator, **arguments}
        answer: dict[str, Any] = self.devtools.send(method, given)
        return answer

    def cookies(self) -> dict[str, str]:
        """The cookies of the site: name to value."""
        return {each["name"]: each["value"] for each in self.context.cookies()}

    def put_cookies(self, cookies: Mapping[str, str]) -> None:
        """Have these cookies too; as of https, since their names begin with `__Host-`."""
        url = self.origin.replace("http:", "https:")
        self.context.add_cookies(
            [{"name": name, "value": value, "url": url} for name, value in cookies.items()]
        )

    def is_too_wide(self) -> bool:
        """Whether the page scrolls sideways on the narrowest phones."""
        size = self.page.viewport_size
        assert size is not None
        self.page.set_viewport_size({"width": NARROW, "height": size["height"]})
        root = "document.documentElement"
        wide: bool = self._evaluate(f"{root}.scrollWidth > {root}.clientWidth")
        self.page.set_viewport_size(size)
        return wide

    def _evaluate(self, expression: str, world: int | None = None) -> Any:
        """The value of an expression; the page's policy does not apply to it (Runtime.evaluate)."""
        where = {} if world is None else {"contextId": world}
        options = {"expression": expression, "awaitPromise": True, "returnByValue": True}
        answer = self.devtools.send("Runtime.evaluate", {**options, **where})
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def evaluate_apart(self, *expressions: str) -> Any:
        """The value of the last expression, in a world of its own: scripts of the page see none."""
        for _ in range(_TRIES):  # a live page loads itself again, and its worlds end
            with contextlib.suppress(Error, AssertionError):  # a page half loaded has no body
                return self._evaluated(expressions)
            self.page.wait_for_timeout(300)
        return self._evaluated(expressions)

    def _evaluated(self, expressions: tuple[str, ...]) -> Any:
        frame = self.devtools.send("Page.getFrameTree")["frameTree"]["frame"]["id"]
        world = self.devtools.send("Page.createIsolatedWorld", {"frameId": frame})
        number = world["executionContextId"]
        *before, last = expressions
        for each in before:
            self._evaluate(f"{each};0", number)
        return self._evaluate(last, number)

    def screenshot(self, path: Path, *, size: tuple[int, int] = PHONE, scheme: Scheme = "light") -> None:
        """The whole page as a PNG file, as wide as `size`."""
        before = self.page.viewport_size
        assert before is not None
        self.page.emulate_media(color_scheme=scheme)
        self.page.set_viewport_size({"width": size[0], "height": size[1]})
        self.page.screenshot(path=path, full_page=True, caret="initial", animations="allow")
        self.page.set_viewport_size(before)
        self.page.emulate_media(color_scheme="light")

    def forgive(self, *texts: str) -> None:
        """Drop faults that the test has provoked; each comes within a moment."""
        for text in texts:
            for _ in range(40):
                if any(text in fault for fault in self.faults):
                    break
                self.page.wait_for_timeout(50)
            else:
                raise AssertionError((text, self.faults))
        self.faults = [f for f in self.faults if not any(text in f for text in texts)]

    def close(self) -> None:
        """Leave the page, then close: Chromium may hang if it loads itself again just then."""
        with contextlib.suppress(Error):
            self.page.goto("about:blank", timeout=_LOAD_MS)
        self.context.close()

    def _watched(self, page: Page) -> Page:
        page.set_default_timeout(WAIT_MS)
        page.add_init_script(_TELL_VIOLATIONS)
        page.on("console", self._on_console)
        page.on("pageerror", lambda error: self.faults.append(f"script: {error}"))
        page.on("requestfailed", self._on_failed)
        page.on("response", self._on_response)
        return page

    def _on_console(self, message: ConsoleMessage) -> None:
        if message.type == "error":
            self.faults.append(f"console: {message.text} {message.location.get('url', '')}")

    def _on_failed(self, request: Request) -> None:
        # Leaving a page ends what it was loading, and its stream of events.
        if "ERR_ABORTED" not in (request.failure or ""):
            self.faults.append(f"request: {request.method} {request.url}: {request.failure}")

    def _on_response(self, response: Response) -> None:
        if response.status >= 500:
            self.faults.append(f"answer: {response.status} {response.url}")
        length = response.headers.get("content-length")
        if length is not None:
            self.sizes[response.url] = int(length)


class Chromium:
    """A running browser; each window of it is a profile that shares nothing with the others."""

    def __init__(self, browser: Browser, camera: Camera) -> None:
        self.browser, self.camera = browser, camera

    @contextlib.contextmanager
    def window(
        self, origin: str, *, size: tuple[int, int] = PHONE, checked: bool = True, **options: Any
    ) -> Iterator[Window]:
        """A window with an authenticator; nothing may have gone wrong in it when it closes."""
        given = {
            "viewport": {"width": size[0], "height": size[1]},
            "device_scale_factor": 2,
            "locale": "en-GB",
            "permissions": ["camera"],
            "reduced_motion": "reduce",
            **options,
        }
        window = Window(self.browser.new_context(**given), origin)
        window.add_authenticator()
        try:
            yield window
            assert not (checked and window.faults), window.faults
        finally:
            window.close()


@contextlib.contextmanager
def running_chromium(folder: Path, *arguments: str) -> Iterator[Chromium]:
    """Chromium, without its sandbox: that cannot run as root, and it opens pages of tests only."""
    camera = Camera(folder / "camera.mjpeg")
    flags = [
        "--no-sandbox",
        "--use-fake-device-for-media-stream",
        f"--use-file-for-fake-video-capture={camera.path}",
        *arguments,
    ]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        try:
            yield Chromium(browser, camera)
        finally:
            browser.close()
