"""Outlines of all commands, kept so that completion imports none of them. A shell.

A wheel carries the table of its commands (`hatch_build.py`). In a source tree there is none:
there an outline is kept beside Python's own compiled files when it was needed for the first time,
until a file of the command line changes.
"""

import contextlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from rossec.cli.completion.outline import Outline

COMMANDS: Final = Path(__file__).parents[1]
SHIPPED: Final = Path(__file__).with_name("outlines.json")
CACHE: Final = Path(__file__).parent / "__pycache__" / "outlines.json"
_MAX: Final = 1024 * 1024


class OutlineTable:
    """The outlines by the places of their commands (`ca.init:init`)."""

    def __init__(
        self, shipped: Path = SHIPPED, cache: Path = CACHE, commands: Path = COMMANDS
    ) -> None:
        self._cache = cache
        self._stamp: str | None = None  # None: what is shipped does not age
        self._outlines = _read(shipped).get("outlines", {})
        if not self._outlines:
            self._stamp = _stamp(commands)
            found = _read(cache)
            self._outlines = found["outlines"] if found.get("stamp") == self._stamp else {}

    def get(self, place: str, make: Callable[[], Outline | None]) -> Outline | None:
        """The outline of the command at `place`; `make` imports it: None if it is a group."""
        if place in self._outlines or self._stamp is None:
            found: Outline | None = self._outlines.get(place) or make()
            return found
        made = make()
        if made is not None:
            self._outlines[place] = made
            self._keep()
        return made

    def _keep(self) -> None:
        """Write the cache; where it cannot be written, completion is slow and right."""
        text = json.dumps({"stamp": self._stamp, "outlines": self._outlines})
        new = self._cache.with_name(f"{self._cache.name}.{os.getpid()}")
        with contextlib.suppress(OSError):
            self._cache.parent.mkdir(exist_ok=True)
            new.write_text(text)
            new.replace(self._cache)


def _read(path: Path) -> dict[str, Any]:
    """A table in a file; empty if it cannot be read."""
    try:
        with path.open("rb") as stream:
            found = json.loads(stream.read(_MAX))
    except (OSError, ValueError):
        return {}
    whole = isinstance(found, dict) and isinstance(found.get("outlines"), dict)
    return found if whole else {}


def _stamp(directory: Path) -> str:
    """What changes when a file of the command line is written, added or removed."""
    files = [
        entry.stat()
        for folder in [directory, *filter(Path.is_dir, directory.iterdir())]
        if folder.name != "__pycache__"
        for entry in os.scandir(folder)
        if entry.name.endswith(".py")
    ]
    newest = max(status.st_mtime_ns for status in files)
    return f"{len(files)} {newest} {sum(status.st_size for status in files)}"
