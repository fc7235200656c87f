"""The output of the command line: lower case, no full stop, an error and then its hint.

Results go to stdout, everything else to stderr. Exit codes: 0 done, 1 refused, 2 wrong usage,
3 done here but not delivered (the master or the node was out of reach), 4 done, but grants made by
hand allow what the policy denies, 5 waiting for the authority or for a person (run it again), 130
interrupted.
"""

import io
import json
import os
import stat
import sys
from typing import Any

from rossec.ros.text import printable as text_on_one_line

REFUSED = 1
USAGE = 2
UNDELIVERED = 3
CONTRADICTED = 4
WAITING = 5
INTERRUPTED = 130


def say(text: str) -> None:
    """One line of result."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()  # a pipe must get each line at once


def say_secret(text: str) -> None:
    """Print a line that others must not read; a file that it is redirected to is closed to them."""
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
    say(json.dumps(value, sort_keys=True))


def note(text: str) -> None:
    """A message on stderr that is not a result."""
    sys.stderr.write(f"rossec: {text}\n")


def fail(message: str, hint: str = "") -> None:
    """An error and what to do about it."""
    sys.stderr.write(f"rossec: error: {printable(message)}\n")
    if hint:
        sys.stderr.write(f"rossec: hint: {printable(hint)}\n")


def printable(text: str) -> str:
    """`text` with control and direction characters escaped: names of peers reach terminals.

    Tabs and newlines are escaped as well: one error is one line.
    """
    return text_on_one_line(text, len(text))
