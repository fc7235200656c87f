"""What must hold for a page in each of its states, and the pictures of it.

`ROSSEC_PICTURES=docs/pictures` has the tests of tests/browser write the pictures of the
documentation there; with `ROSSEC_EVERY_PICTURE=1` each state phone and desktop, light and dark.
"""

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import axe_playwright_python
import numpy as np
from PIL import Image

from tests.support.browser import DESKTOP, PHONE, Scheme, Window

MAX_PAGE: Final = 100_000  # bytes of a page with all that it loads
MAX_PICTURE: Final = 150_000
_ENOUGH: Final = 75_000  # a picture of fewer bytes keeps all of its pixels
_TALLEST: Final = 3200  # pixels of a picture
_AXE: Final = Path(axe_playwright_python.__file__).with_name("axe.min.js")
_VARIANTS: Final[dict[str, tuple[tuple[int, int], Scheme]]] = {
    "phone": (PHONE, "light"),
    "phone-dark": (PHONE, "dark"),
    "desktop": (DESKTOP, "light"),
    "desktop-dark": (DESKTOP, "dark"),
}


def from_environment() -> "PageCheck":
    """The check that draws where `ROSSEC_PICTURES` says, or nothing."""
    folder = os.environ.get("ROSSEC_PICTURES")
    return PageCheck(Path(folder) if folder else None)


class PageCheck:
    """Checks states of pages; pictures of those go to `folder`, without one there are none."""

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
        self._every = os.environ.get("ROSSEC_EVERY_PICTURE") == "1"
        self.seen: list[str] = []

    def __call__(self, window: Window, state: str, *keep: str) -> None:
        """Check the state that `window` shows, called `state`; `keep` names its pictures."""
        self.seen.append(state)
        assert not (found := accessibility(window)), found
        window.page.emulate_media(color_scheme="dark")
        assert not (found := accessibility(window, "color-contrast")), found
        window.page.emulate_media(color_scheme="light")
        assert not window.is_too_wide(), f"{state} scrolls sideways"
        assert 0 < sum(window.sizes.values()) < MAX_PAGE, f"size: {window.sizes}"
        if self.folder is not None:
            self._draw(window, state, _VARIANTS if self._every else keep or ("phone",))

    def _draw(self, window: Window, state: str, names: Iterable[str]) -> None:
        assert self.folder is not None
        for name in names:
            size, scheme = _VARIANTS[name]
            path = self.folder / f"{state}-{name}.png"
            window.screenshot(path, size=size, scheme=scheme)
            _shrink(path)
            assert path.stat().st_size < MAX_PICTURE, path


def accessibility(window: Window, *rules: str) -> list[str]:
    """What axe-core finds in the page, by all of its rules or by these alone."""
    options: dict[str, Any] = {"resultTypes": ["violations", "passes"]}
    if rules:
        options["runOnly"] = list(rules)
    found = window.evaluate_apart(
        _AXE.read_text(), f"axe.run(document, {json.dumps(options)}).then(JSON.stringify)"
    )
    report = json.loads(found)
    assert report["passes"] or rules, "no rule of axe-core applied"
    return [
        f"{each['id']}: {each['help']}: {node['html'][:160]} ({node['failureSummary']})"
        for each in report["violations"]
        for node in each["nodes"]
    ]


def _true_colours(few: Image.Image, full: Image.Image) -> None:
    """Give each colour of `few` the usual one of what it stands for: a background keeps its own."""
    palette, colours, which = few.getpalette() or [], np.asarray(full), np.asarray(few)
    for number in map(int, np.unique(which)):
        usual = np.median(colours[which == number], axis=0)
        palette[3 * number : 3 * number + 3] = map(int, usual)
    few.putpalette(palette)


def _shrink(path: Path) -> None:
    """The upper part, in fewer colours, then in fewer pixels, until the file is small enough."""
    with Image.open(path) as picture:
        tall = picture.convert("RGB")
    full = tall.crop((0, 0, tall.width, min(tall.height, _TALLEST)))
    half = full.resize((full.width // 2, full.height // 2), Image.Resampling.LANCZOS)
    for each, colours, most in ((full, 128, _ENOUGH), (half, 128, MAX_PICTURE), (half, 64, 0)):
        # By coverage: a rare colour is one that says something, as the green of what is whole.
        few = each.quantize(colours, Image.Quantize.MAXCOVERAGE, 2, dither=Image.Dither.NONE)
        _true_colours(few, each)
        few.save(path, optimize=True)
        if path.stat().st_size < most:
            return
