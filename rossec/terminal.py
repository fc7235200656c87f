"""The output of the command line: lower case, no full stop, an error and then its hint.

Results go to stdout, everything else to stderr. With `--json` a command that acts prints its facts
(`record`) as one document, and what it says to people goes to stderr, where a question can still be
understood (docs/spec/results.md). Every command prints through these functions, and they escape
whatever they are given: names of peers and files, reasons in a policy and arguments reach a terminal
as text, wherever they are from. Colour stands only beside words that say the same, never alone.
"""

import io
import json
import os
import re
import stat
import sys
from collections.abc import Callable, Iterable, Mapping
from contextvars import ContextVar
from typing import Any, Final, TextIO

from rossec.peer_limits import printable as text_on_one_line

# Exit codes; of several names, 1 says that one or more were refused, and the others are done.
REFUSED = 1
USAGE = 2
UNDELIVERED = 3  # done here, but the master or the node was out of reach
CONTRADICTED = 4  # done, but grants made by hand allow what the policy denies
WAITING = 5  # for the authority or for a person: run it again
INCOMPLETE = 6
INTERRUPTED = 130

RED: Final = "31"
GREEN: Final = "32"
YELLOW: Final = "33"
BOLD: Final = "1"

STATES: Final = {
    "ok": GREEN,
    "held": GREEN,
    "delivered": GREEN,
    "valid": GREEN,
    "in force": GREEN,
    "not ok": RED,
    "revoked": RED,
    "denied": RED,
    "refused": RED,
    "expired": YELLOW,
    "stale": YELLOW,
    "waiting": YELLOW,
    "unknown": YELLOW,
}

PAINTED: Final = re.compile(
    "(\x1b\\[(?:{})m *(?:{}) *\x1b\\[0m)".format("|".join({*STATES.values()}), "|".join(STATES))
)
"""A state as `state` paints it, and no other sequence that steers a terminal."""


def is_wanted(stream: TextIO, environ: Mapping[str, str] | None = None) -> bool:
    # No colour with NO_COLOR (https://no-color.org), for a dumb terminal, and where there is none.
    found = os.environ if environ is None else environ
    return (
        not found.get("NO_COLOR")
        and found.get("TERM", "dumb") != "dumb"
        and not stream.closed
        and stream.isatty()
    )


def paint(text: str, colour: str, stream: TextIO) -> str:
    return f"\x1b[{colour}m{text}\x1b[0m" if colour and is_wanted(stream) else text


def painted_state(word: str, stream: TextIO) -> str:
    return paint(word, STATES.get(word.strip(), ""), stream)


_SURROGATE: Final = re.compile("[\ud800-\udfff]")

FACTS: Final[ContextVar[dict[str, Any] | None]] = ContextVar("FACTS", default=None)
"""Where `record` puts what it is told; None: no `--json`."""

TEMPORARY: Final[list[Callable[[], None]]] = []
"""Takes away a line that is on the terminal for the moment, before another is printed."""


def say(text: str, /, **facts: Any) -> None:
    """One line of result, and its `facts` for `--json`; a line break in `text` is escaped."""
    record(**facts)
    _say([text])


def say_block(text: str) -> None:
    """Lines of result that are meant to be several, and their tabs: a document, a message."""
    _say(text.split("\n"), tabs=True)


def _say(lines: Iterable[str], *, tabs: bool = False) -> None:
    stream = sys.stdout if FACTS.get() is None else sys.stderr
    parts = (line.split("\t") if tabs else [line] for line in lines)
    painted = ("\t".join(_painted(part, stream) for part in line) for line in parts)
    _write(stream, "".join(f"{line}\n" for line in painted))
    stream.flush()  # a pipe must get each line at once


def record(**facts: Any) -> None:
    """Facts of the result, for `--json`."""
    if (found := FACTS.get()) is not None:
        found.update(facts)


def say_secret(text: str) -> None:
    """Print lines that others must not read; a file they are redirected to is closed to them.

    With `--json` they are in the document, and nowhere else.
    """
    if FACTS.get() is None:
        _close_to_others()
        say_block(text)


def say_picture(text: str, *, is_secret: bool = False) -> None:
    """A picture of the terminal's own blocks and colours, that is `qr.terminal`'s; not escaped."""
    if is_secret and FACTS.get() is not None:
        return
    if is_secret:
        _close_to_others()
    stream = sys.stdout if FACTS.get() is None else sys.stderr
    _write(stream, f"{text}\n")
    stream.flush()


def note_picture(text: str) -> None:
    """The same on stderr."""
    _write(sys.stderr, f"{text}\n")


def _close_to_others() -> None:
    try:
        output = sys.stdout.fileno()
        if stat.S_ISREG(os.fstat(output).st_mode):  # the shell made it as its umask says
            os.fchmod(output, 0o600)
    except io.UnsupportedOperation:  # it is no file
        pass
    except OSError as error:  # another user's file, or of a file system without modes
        note(f"others may read the file: {error.strerror}")


def say_json(value: Any) -> None:
    """A result for programs: one line of JSON."""
    say(to_json(value))


def to_json(value: Any) -> str:
    """One line of JSON that every parser takes (RFC 7493 2.1: no surrogate stands alone)."""
    return json_text(value, sort_keys=True)


def json_text(value: Any, indent: int | None = None, *, sort_keys: bool = False) -> str:
    """JSON in ASCII, without a control character; half a surrogate pair is written as an escape."""
    text = json.dumps(_whole(value), sort_keys=sort_keys, indent=indent)
    return text.replace("\x7f", "\\u007f")


def _whole(value: Any) -> Any:
    match value:
        case str():
            return _SURROGATE.sub(lambda found: printable(found[0]), value)
        case dict():
            return {_whole(key): _whole(item) for key, item in value.items()}
        case list() | tuple():
            return [_whole(item) for item in value]
        case _:
            return value


def note(text: str) -> None:
    """A message on stderr that is not a result."""
    _write(sys.stderr, f"rossec: {printable(text)}\n")


def fail(message: str, hint: str = "") -> None:
    """An error and what to do about it; what a peer said begins with `rossec: ` already."""
    message = message.removeprefix("rossec: ")
    error = paint("error:", RED, sys.stderr)
    _write(sys.stderr, f"rossec: {error} {printable(message)}\n")
    if hint:
        remedy = paint("hint:", BOLD, sys.stderr)
        _write(sys.stderr, f"rossec: {remedy} {printable(hint)}\n")


def state(word: str) -> str:
    """A state as results show it: the word, and on a terminal its colour."""
    return painted_state(word, sys.stdout if FACTS.get() is None else sys.stderr)


def _write(stream: TextIO, text: str) -> None:
    for take_away in TEMPORARY:
        take_away()
    encoding = stream.encoding or "utf-8"
    stream.write(text.encode(encoding, "backslashreplace").decode(encoding))


def _painted(line: str, stream: TextIO) -> str:
    if not is_wanted(stream):
        return printable(line)
    return "".join(part if place % 2 else printable(part) for place, part in enumerate(PAINTED.split(line)))


def printable(text: str) -> str:
    """`text` with control and direction characters escaped: names of peers reach terminals.

    Tabs and newlines are escaped as well: one error is one line.
    """
    return text_on_one_line(text, len(text))
