"""The README's first picture: the console's first page in Chromium, of `rossec console --demo`.

`.venv/bin/python tools/console_picture.py` writes docs/pictures/console-desktop.png.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import expect

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tests.support.browser import DESKTOP, running_chromium  # noqa: E402
from tests.support.pagecheck import PageCheck  # noqa: E402
from tests.support.person import press  # noqa: E402
from tests.support.ports import free_port  # noqa: E402

WAIT_MS = 60_000
PICTURE = ROOT / "docs" / "pictures" / "console-desktop.png"


def main() -> None:
    """Run the demo's home, look at it, and end it."""
    command = [sys.executable, "-u", "-m", "rossec", "console", "--demo"]
    demo = subprocess.Popen(
        [*command, "--port", str(free_port())], cwd=ROOT, text=True, stdout=subprocess.PIPE
    )
    try:
        draw(login_address(demo))
    finally:
        demo.terminate()
        demo.wait(30)


def login_address(demo: subprocess.Popen[str]) -> str:
    """What the demo says when it is ready."""
    assert demo.stdout is not None
    for line in demo.stdout:
        if "/login#" in line:
            return line.strip()
    raise SystemExit("rossec console --demo ended")


def draw(address: str) -> None:
    """Log in by the code, to look, and draw the first page."""
    origin = address.partition("/login")[0]
    with (
        tempfile.TemporaryDirectory() as folder,
        running_chromium(Path(folder)) as chromium,
        chromium.window(origin, size=DESKTOP) as window,
    ):
        window.page.goto(address)
        press(window, "Only look")
        expect(window.page.locator("table")).to_be_visible(timeout=WAIT_MS)
        PageCheck(PICTURE.parent)(window, "console", "desktop")
        below = window.page.get_by_role("heading", name="What happened").bounding_box()
    assert below is not None
    with Image.open(PICTURE) as whole:
        scale = whole.width / DESKTOP[0]
        upper = whole.crop((0, 0, whole.width, min(whole.height, int((below["y"] - 36) * scale))))
    upper.save(PICTURE, optimize=True)


if __name__ == "__main__":
    main()
