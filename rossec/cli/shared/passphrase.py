"""Secrets of a command: a passphrase from a file, a systemd credential or the terminal, or a pasted code.

Never from an environment variable or an argument: both are visible to others on the machine.
"""

import os
import sys
import termios
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import click

from rossec.cli.shared import options
from rossec.cli.shared.context import reraise_interrupt
from rossec.cli.shared.options import FILE
from rossec.errors import ConfigurationError

_MORE: Final = "the code goes on, or Enter to end: "
CREDENTIAL: Final = "rossec-ca-passphrase"
MINIMUM: Final = 12
_MAX_FILE: Final = 4096
option = options.option(
    "--passphrase-file", "read the passphrase of the authority's key from this file (first line)", type=FILE
)


def read_lines(question: str, is_whole: Callable[[str], bool]) -> str:
    """Lines from the terminal, not shown, until `is_whole`, an empty one or the end.

    A code from a mail has line breaks: `getpass` would throw away what is pasted behind the first.
    """
    with _without_echo() as terminal:
        os.write(terminal, f"{question}: ".encode())
        lines = list[str]()
        while len(lines) < 32:
            line = os.read(terminal, 4096).decode(errors="replace")  # octets; a terminal gives no longer ones
            lines.append(line)
            if not line.strip() or is_whole("".join(lines)):
                break
            os.write(terminal, f"\n{_MORE}".encode())
        os.write(terminal, b"\n")
    return "".join(lines)


@contextmanager
def _without_echo() -> Iterator[int]:
    # The terminal of this process, as it was afterwards; what was not read then is gone.
    terminal = os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY)
    try:
        before = termios.tcgetattr(terminal)
        # Not `getpass`: it would throw away what is pasted behind the first line of a code.
        hidden = [*before[:3], before[3] & ~termios.ECHO, *before[4:]]
        termios.tcsetattr(terminal, termios.TCSADRAIN, hidden)
        try:
            yield terminal
        finally:  # a rest of a paste must not reach the shell
            termios.tcsetattr(terminal, termios.TCSAFLUSH, before)
    finally:
        os.close(terminal)


def read(file: Path | None, environ: Mapping[str, str]) -> str:
    given = _given(file, environ)
    return _ask("passphrase of the authority's key") if given is None else given


def _given(file: Path | None, environ: Mapping[str, str]) -> str | None:
    # systemd's credentials are files of this service alone; a variable or an argument others could see.
    directory = environ.get("CREDENTIALS_DIRECTORY")
    if file is None and directory is not None and (Path(directory) / CREDENTIAL).exists():
        file = Path(directory) / CREDENTIAL
    if file is None:
        return None
    # Of a pipe (`<(pass show ca)`) the mode means nothing: there its owner counts.
    if file.stat().st_mode & 0o077 and not (not file.is_file() and file.stat().st_uid in (os.getuid(), 0)):
        raise ConfigurationError(f"{file} can be read by others", f"chmod 600 {file}")
    with file.open("rb") as stream:
        lines = stream.read(_MAX_FILE).splitlines()
    if not lines or not lines[0]:
        raise ConfigurationError(f"{file} is empty", "its first line is the passphrase")
    try:
        return lines[0].decode()
    except UnicodeDecodeError:
        raise ConfigurationError(
            f"{file} is not UTF-8 text", "its first line is the passphrase, as one would type it"
        ) from None


def _ask(question: str, check_new: Callable[[str], str] | None = None) -> str:
    try:
        answer: str = click.prompt(
            question,
            hide_input=can_hide(),
            err=True,
            confirmation_prompt=check_new is not None,
            value_proc=check_new,
        )
    except click.Abort as abort:
        reraise_interrupt(abort)
        raise ConfigurationError(
            "no passphrase was given", "type it, or give --passphrase-file FILE"
        ) from None
    return answer


def can_hide() -> bool:
    """Whether there is a terminal whose echo can be turned off: as `getpass` looks for one."""
    try:
        os.close(os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY))
    except OSError:
        return sys.stdin is not None and sys.stdin.isatty()
    return True


def choose(file: Path | None, environ: Mapping[str, str]) -> str:
    given = _given(file, environ)
    if given is None:
        question = f"new passphrase for the authority's key (at least {MINIMUM} characters)"
        given = _ask(question, long_enough)
    return _long_enough(given)


def long_enough(typed: str) -> str:
    """A new passphrase that was typed once; if it is too short click says so and asks again."""
    try:
        return _long_enough(typed)
    except ConfigurationError as error:
        raise click.UsageError(f"{error}: {error.hint}") from None


def _long_enough(given: str) -> str:
    if len(given) < MINIMUM:
        raise ConfigurationError(
            f"a passphrase of {len(given)} characters protects nothing",
            f"use at least {MINIMUM}, for example four random words",
        )
    return given
