"""The output of the command line: lower case, no full stop, an error and then its hint.

Results go to stdout, everything else to stderr. Exit codes: 0 done, 1 refused, 2 wrong usage,
3 done here but not delivered (the master or the node was out of reach), 4 done, but grants made by
hand allow what the policy denies, 5 waiting for the authority or for a person (run it again), 130
interrupted. Of several names, 1 says that one or more were refused; the others are done.

With `--json` a command that acts prints its facts (`record`) as one document, and what it says to
people goes to stderr, where a question can still be understood (docs/spec/results.md).
"""

import io
import json
import os
import stat
import sys
from collections.abc import Callable
from contextvars import ContextVar
from typing import Any, Final

from rossec import colour
from rossec.ros.text import printable as text_on_one_line

REFUSED = 1
USAGE = 2
UNDELIVERED = 3
CONTRADICTED = 4
WAITING = 5
INTERRUPTED = 130

FACTS: Final[ContextVar[dict[str, Any] | None]] = ContextVar("FACTS", default=None)
"""Where `record` puts what it is told; None: no `--json`."""

TEMPORARY: Final[list[Callable[[], None]]] = []
"""Takes away a line that is on the terminal for the moment, before another is printed."""


def say(text: str) -> None:
    """One line of result."""
    _make_room()
    stream = sys.stdout if FACTS.get() is None else sys.stderr
    stream.write(f"{text}\n")
    stream.flush()  # a pipe must get each line at once


def record(**facts: Any) -> None:
    """Facts of the result, for `--json`."""
    if (found := FACTS.get()) is not None:
        found.update(facts)


def say_secret(text: str) -> None:
    """Print a line that others must not read; a file that it is redirected to is closed to them.

    With `--json` it is in the document, and nowhere else.
    """
    if FACTS.get() is not None:
        return
    try:
        output = sys.stdout.fileno()
        if stat.S_ISREG(os.fstat(output).st_mode):  # the shell made it as its umask says
            os.fchmod(output, 0o600)
    except io.UnsupportedOperation:  # it is no file
        pass
    except OSError as error:  # another user's file, or of a file system without modes
        note(f"others may read the file: {error.strerror}")
    say(text)


def say_json(value: Any) -> None:
    """A result for programs: one line of JSON."""
    say(to_json(value))


def to_json(value: Any) -> str:
    """One line of JSON."""
    return json.dumps(value, sort_keys=True)


def note(text: str) -> None:
    """A message on stderr that is not a result."""
    _make_room()
    sys.stderr.write(f"rossec: {text}\n")


def fail(message: str, hint: str = "") -> None:
    """An error and what to do about it; what a peer said begins with `rossec: ` already."""
    _make_room()
    message = message.removeprefix("rossec: ")
    error = colour.paint("error:", colour.RED, sys.stderr)
    sys.stderr.write(f"rossec: {error} {printable(message)}\n")
    if hint:
        remedy = colour.paint("hint:", colour.BOLD, sys.stderr)
        sys.stderr.write(f"rossec: {remedy} {printable(hint)}\n")


def state(word: str) -> str:
    """A state as results show it: the word, and on a terminal its colour."""
    return colour.state(word, sys.stdout if FACTS.get() is None else sys.stderr)


def _make_room() -> None:
    for take_away in TEMPORARY:
        take_away()


def printable(text: str) -> str:
    """`text` with control and direction characters escaped: names of peers reach terminals.

    Tabs and newlines are escaped as well: one error is one line.
    """
    return text_on_one_line(text, len(text))
