"""A line that says what takes longer than a second: on stderr, if that is a terminal.

It gives way to every other line, and is gone without a trace when the work is done: a pipe, a file
and a program that reads `--json` never see it. It is drawn anew each second, so that a person sees
that the command is not stuck. What asks for anything stays outside.
"""

import contextlib
import sys
import threading
import time
from collections.abc import Iterator
from typing import Final

from rossec.terminal import FACTS, TEMPORARY, printable

AFTER: Final = 1.0  # seconds
_WIDTH: Final = 72  # one line, on every terminal
_CLEAR: Final = "\r\x1b[K"


@contextlib.contextmanager
def working(what: str, *, quiet: bool = False) -> Iterator[None]:
    """Say `what` while the body runs, which asks for nothing; `quiet`: do not (`--json`)."""
    if quiet or not _is_shown():
        yield
        return
    line = _Line(what)
    try:
        yield
    finally:
        line.end()


def _is_shown() -> bool:
    return FACTS.get() is None and not sys.stderr.closed and sys.stderr.isatty()


class _Line:
    """The line, drawn by a thread of its own: the work may hold this one."""

    def __init__(self, what: str) -> None:
        self._what = printable(what)[:_WIDTH]
        self._begun = time.monotonic()
        self._done = threading.Event()
        self._drawing = threading.Lock()
        self._shown = False
        self._thread = threading.Thread(target=self._run, name="rossec busy", daemon=True)
        self._thread.start()
        TEMPORARY.append(self._take_away)

    def end(self) -> None:
        """Take the line away for good."""
        TEMPORARY.remove(self._take_away)
        self._done.set()
        self._thread.join()
        self._take_away()

    def _run(self) -> None:
        while not self._done.wait(AFTER):
            with self._drawing:
                self._write(f"{_CLEAR}{self._what} ({time.monotonic() - self._begun:.0f} s)")
                self._shown = True

    def _take_away(self) -> None:
        with self._drawing:
            if self._shown:
                self._write(_CLEAR)
            self._shown = False

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError, ValueError):  # the terminal is gone
            sys.stderr.write(text)
            sys.stderr.flush()
