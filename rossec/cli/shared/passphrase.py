"""The passphrase of the authority's key: from a file, a systemd credential or the terminal.

Never from an environment variable or an argument: both are visible to others on the machine.
"""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import click

from rossec.cli.shared import options
from rossec.cli.shared.context import reraise_interrupt
from rossec.cli.shared.hidden import can_hide
from rossec.errors import ConfigurationError

CREDENTIAL: Final = "rossec-ca-passphrase"
MINIMUM: Final = 12
_MAX_FILE: Final = 4096


option = click.option(
    "--passphrase-file", type=options.FILE,
    help="read the passphrase of the authority's key from this file (first line)",
)  # fmt: skip


def read(file: Path | None, environ: Mapping[str, str]) -> str:
    """The passphrase of an existing key.

    Raises:
        ConfigurationError: the file is empty, not text, or readable by others.
    """
    given = _given(file, environ)
    if given is not None:
        return given
    return _ask("passphrase of the authority's key")


def choose(file: Path | None, environ: Mapping[str, str]) -> str:
    """A passphrase for a new key.

    Raises:
        ConfigurationError: shorter than 12 characters.
    """
    given = _given(file, environ)
    if given is None:
        question = f"new passphrase for the authority's key (at least {MINIMUM} characters)"
        given = _ask(question, long_enough)
    return _long_enough(given)


def _long_enough(given: str) -> str:
    if len(given) < MINIMUM:
        raise ConfigurationError(
            f"a passphrase of {len(given)} characters protects nothing",
            f"use at least {MINIMUM}, for example four random words",
        )
    return given


def long_enough(typed: str) -> str:
    """A new passphrase that was typed once; if it is too short click says so and asks again.

    Raises:
        click.UsageError: it is too short.
    """
    try:
        return _long_enough(typed)
    except ConfigurationError as error:
        raise click.UsageError(f"{error}: {error.hint}") from None


def _ask(question: str, check_new: Callable[[str], str] | None = None) -> str:
    """`check_new`: it is a new one, which is checked before it is asked for a second time."""
    try:
        answer: str = click.prompt(
            question, hide_input=can_hide(), err=True,
            confirmation_prompt=check_new is not None, value_proc=check_new,
        )  # fmt: skip
    except click.Abort as abort:
        reraise_interrupt(abort)
        raise ConfigurationError(
            "no passphrase was given", "type it, or give --passphrase-file FILE"
        ) from None
    return answer


def _given(file: Path | None, environ: Mapping[str, str]) -> str | None:
    directory = environ.get("CREDENTIALS_DIRECTORY")
    if file is None and directory is not None and (Path(directory) / CREDENTIAL).exists():
        file = Path(directory) / CREDENTIAL
    if file is None:
        return None
    if file.stat().st_mode & 0o077 and not _is_ours_alone(file):
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


def _is_ours_alone(file: Path) -> bool:
    """A pipe (`--passphrase-file <(pass show ca)`) has a mode without meaning."""
    return not file.is_file() and file.stat().st_uid in (os.getuid(), 0)
