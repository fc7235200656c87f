"""`rossec node join`: the code of an invitation in, an identity on the disk."""

import asyncio
import sys
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import BinaryIO, Final

import click

from ca.certificates import to_pem
from ca.enrollment import invitation, ndef
from ca.enrollment.invitation import InvitationCode
from ca.errors import CertificateRefused, CodeRefused
from ca.names import check_name, is_reserved
from ca.patterns import covers
from rossec import files
from rossec.authority.home import fingerprint
from rossec.cli.shared import options, rules
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.hidden import read_lines
from rossec.cli.shared.results import json_result
from rossec.clock import format_time
from rossec.enrollment.join_node import ask_name, join
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.terminal import note, record, say

_MAX_INPUT: Final = 4096
_QUESTION: Final = "the line of `rossec ca invite` (it is not shown)"


@click.command("join")
@click.option(
    "--file", "path", type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="read the code from this file: the line, or an NFC tag (NDEF)",
)  # fmt: skip
@click.option("--name", help="the node's name, if the invitation is for more than one")
@click.option(
    "--meta", "meta_path", type=options.FILE, metavar="FILE",
    help="the node's metadata: take the name that the authority's rules give for them",
)  # fmt: skip
@json_result()
@pass_environment
def command(
    environment: Environment, path: Path | None, name: str | None, meta_path: Path | None
) -> None:
    """Join a site by an invitation: make the key, prove the code, install the identity.

    The code is read from standard input, or from a file; never from an argument or the environment,
    which other users of this host can see. The authority must be running (`rossec ca serve`). If
    this waits for it or for a person, run it again: the same request gets its answer.

    Exit codes: 0 joined, 1 refused, 2 wrong usage, 5 waiting, 130 interrupted.
    """
    if name is not None and meta_path is not None:
        raise click.UsageError("give --name or --meta, not both")
    if name is not None:
        check_name(name)  # before a person is asked for the code
    metadata = b"" if meta_path is None else rules.read_metadata(meta_path)
    code = _code(path, sys.stdin.buffer)
    if metadata:
        name = asyncio.run(ask_name(code, metadata, now))
    home = NodeHome.of(environment.home, _name(code, name))
    if _is_enrolled(home, code):
        record(name=home.name, joined=False)
        say(f"{home.name} is enrolled already")
        return
    if not (home.path / "node.key").exists():
        code.check_time(now())  # a second run may be late: its request may have its answer
    wildcard = code.wildcard
    found = asyncio.run(join(code, partial(home.join_request, wildcard=wildcard), now, metadata))
    identity = home.install(to_pem(*found.chain, found.root), now())
    record(name=home.name, joined=True, domain=identity.domain, expires=identity.not_after)
    say(f"authority of {identity.domain}, fingerprint {fingerprint(found.anchor)}")
    tail = f" and {home.name}_*" if wildcard else ""
    say(f"{home.name}{tail} is enrolled until {format_time(identity.not_after)}")


def _code(path: Path | None, stdin: BinaryIO) -> InvitationCode:
    """The code from the file, or from standard input; from a terminal it is not shown.

    Raises:
        CodeRefused: not a code.
        ConfigurationError: the file is too large.
    """
    if path is not None:
        if path.is_file() and path.stat().st_mode & 0o077:
            note(f"{path} can be read by other users, who could join by it: chmod 600 {path}")
        return _parsed(files.read(path, _MAX_INPUT))
    if not sys.stdin.isatty():
        return _parsed(stdin.read(_MAX_INPUT + 1))
    typed = read_lines(_QUESTION, _is_whole)
    if not typed.strip():
        raise ConfigurationError("no code was given", "paste the line, or give --file")
    return invitation.parse(typed)


def _is_whole(typed: str) -> bool:
    """Whether what was pasted so far is a code: a mail or a chat may have broken its line."""
    try:
        invitation.parse(typed)
    except CodeRefused:
        return False
    return True


def _parsed(data: bytes) -> InvitationCode:
    if ndef.is_message(data):
        return ndef.read(data)
    try:
        return invitation.parse(data.decode())
    except UnicodeDecodeError:
        raise CodeRefused(
            "this is not the code of an invitation", "give the line of `rossec ca invite`"
        ) from None


def _name(code: InvitationCode, given: str | None) -> str:
    """The name to join as: the one of the invitation, or the given one within it.

    Raises:
        ConfigurationError: it must be given, or the invitation is not for it.
    """
    pattern = code.pattern
    if given is None:
        if "*" in pattern:
            raise ConfigurationError(
                f"the invitation is for all names {pattern}: which is this node's?",
                f"give it: --name {pattern.replace('**', 'robot07').replace('*', 'robot07')}",
            )
        return pattern
    if is_reserved(given):
        raise ConfigurationError(
            f"{given} is reserved: no invitation is for it",
            f"enroll it in person: rossec node enroll {given}",
        )
    if not covers(pattern, given):
        raise ConfigurationError(
            f"the invitation is not for {given}, but for {pattern}",
            "give another name, or ask for another invitation: rossec ca invite PATTERN",
        )
    return given


def _is_enrolled(home: NodeHome, code: InvitationCode) -> bool:
    """Whether this node has a valid identity of the authority that the code names.

    Raises:
        ConfigurationError: it trusts another authority.
    """
    if not (home.path / "ca.pem").exists():
        return False
    if sha256(home.anchor().certificate).digest() != code.root:
        raise ConfigurationError(
            f"{home.name} trusts another authority already",
            f"to change it, move {home.path} away and join again",
        )
    if not (home.path / "node.pem").exists():
        return False
    try:
        home.identity(now())
    except CertificateRefused:
        return False
    return True
