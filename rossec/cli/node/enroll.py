"""`rossec node enroll | confirm | labels | join`: a node gets its identity by a code, over the network."""

import asyncio
import os
import re
import secrets
import signal
import sys
import termios
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import BinaryIO, Final

import click

from ca.certificates import to_pem
from ca.enrollment import NONCE_SIZE, WINDOW, invitation, qr
from ca.enrollment.sides import NodeEnrollment, NodeState, Pending, group_digits
from ca.errors import CertificateRefused, CodeRefused, EnrollmentOver, HintedError
from ca.names import check_name, is_reserved, pattern_covers
from ca.svid import check_request
from rossec import clock, files
from rossec.authority.home import fingerprint, format_fingerprint
from rossec.cli.shared import options, rules
from rossec.cli.shared.context import Duration, Environment, now, pass_environment, reraise_interrupt
from rossec.cli.shared.master import own_address
from rossec.cli.shared.options import FILE, PATH, flag, json_result, option
from rossec.cli.shared.passphrase import read_lines
from rossec.enrollment import WaitingNode, ask_name
from rossec.enrollment import enroll as enrollment_control
from rossec.enrollment.join import join
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.host import addresses
from rossec.ros.names import is_loopback
from rossec.terminal import note, printable, record, say, say_picture

SAME_DIGITS: Final = "does the authority show the same digits?"
_CLEAR: Final = "\r\x1b[K"
_MAX_REFUSALS: Final = 10  # any peer that reaches the port could fill the screen
_DIGITS = re.compile(r"[0-9]{6}", re.ASCII)
_MAX_INPUT: Final = 4096


@click.command()
@click.argument("name")
@options.domain
@flag("--anonymous", "for anonymous nodes too: NAME and NAME_*")
@flag("--label", "wait for an authority that read the printed label")
@option("--address host", "the address in the code, instead of the one found")
@option("--port", "listen here [any; a label's is 11317]", type=click.IntRange(0, 65535))
@option("--for window", "with --label: wait so long [15m]", type=Duration(1))
@option("--png", "write the code to this PNG file too", type=PATH)
@option("--svg", "write the code to this SVG file too", type=PATH)
@json_result(pass_environment)
def enroll(
    environment: Environment,
    name: str,
    domain: str,
    anonymous: bool,
    label: bool,
    host: str | None,
    port: int | None,
    window: int | None,
    png: Path | None,
    svg: Path | None,
) -> None:
    """Enroll the node NAME: show its code, wait for the authority, and for your confirmation.

    The code holds for five minutes and one use. When the authority has answered, both sides show
    six digits: confirm here, or with `rossec node confirm`, only if they are the same. With --label
    the printed label is enough, and only the digits protect against an impostor.

    Exit codes: 0 enrolled, 1 refused or too late, 2 wrong usage, 130 interrupted.
    """
    if window is not None and not label:
        raise click.UsageError("a code on a screen holds for five minutes: --for needs --label")
    home = NodeHome.of(environment.home, name)
    made = home.label_request if label else home.screen_request
    csr = made(domain, wildcard=anonymous)
    core = NodeEnrollment(
        home.signer(),
        csr,
        domain,
        secret=b"" if label else secrets.token_bytes(qr.SECRET_SIZE),
        contribution=secrets.token_bytes(NONCE_SIZE),
        expires=now() + (window or (3 * WINDOW if label else WINDOW)),
        wildcard=anonymous,
    )
    where = host or own_address(environment)
    listen = port if port is not None else addresses.DEFAULT_PORT * label
    asyncio.run(EnrollmentScreen(home, core, label=label, png=png, svg=svg).run(where, listen))
    record(name=home.name, domain=domain, path=str(home.path))


class EnrollmentScreen:
    def __init__(
        self, home: NodeHome, core: NodeEnrollment, *, label: bool, png: Path | None, svg: Path | None
    ) -> None:
        self._home = home
        self._core = core
        self._label = label
        self._png, self._svg = png, svg
        self._refusals = 0
        self._node = WaitingNode(core, now, self._show_refusal)

    async def run(self, host: str, port: int) -> None:
        stopped = EnrollmentOver("the enrollment was stopped")
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, self._node.stop, stopped)
        listener = await enrollment_control.serve(self._home.path, self._handle_control)
        try:
            async with self._node:
                await self._node.listen(host if is_loopback(host) else None, port)
                where = addresses.join(host, self._node.port)
                text = self._core.code(where)
                for path, picture in ((self._png, qr.png), (self._svg, qr.svg)):
                    if path is not None:
                        files.replace(path, picture(text), 0o644 if self._label else 0o600)
                if not self._label:
                    say_picture(qr.terminal(text))
                say(text)
                # Without the code: an argument is seen by every user of that host.
                command = "rossec ca enroll" + f" --address {where}" * self._label
                say(f"{self._home.name} waits at {where}; at the authority, which asks for it: {command}")
                await self._wait()
        finally:
            listener.close()
            enrollment_control.remove(self._home.path)

    async def _wait(self) -> None:
        try:
            await self._node.until(NodeState.PENDING, NodeState.ENROLLED, every=self._countdown)
            self._clear_line()
            with self._confirmation():
                await self._node.until(NodeState.ENROLLED, every=lambda _: None)
        finally:
            self._node.stop(EnrollmentOver("the node has stopped waiting"))
            self._clear_line()
        say(f"{self._home.name} is enrolled in {self._core.request.domain}")

    def _countdown(self, left: int) -> None:
        if is_live():
            minutes, seconds = divmod(max(0, left), 60)
            sys.stderr.write(f"{_CLEAR}{minutes}:{seconds:02} left ")
            sys.stderr.flush()

    def _clear_line(self) -> None:
        if is_live():
            sys.stderr.write(_CLEAR)

    def _show_refusal(self, what: str) -> None:
        self._refusals += 1
        if self._refusals <= _MAX_REFUSALS:
            self._clear_line()
            note(f"refused {what}")
        if self._refusals == _MAX_REFUSALS:
            note("further refusals are not shown")

    @contextmanager
    def _confirmation(self) -> Iterator[None]:
        for line in authority_lines(self._pending()):
            say(line)
        if not sys.stdin.isatty():
            say(f"the same at the authority? then: rossec node confirm {self._home.name} DIGITS")
            yield
            return
        # Input typed before the digits were shown is not an answer.
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
        sys.stderr.write(f"{SAME_DIGITS} [y/N]: ")
        sys.stderr.flush()
        loop, stdin = asyncio.get_running_loop(), sys.stdin.fileno()
        loop.add_reader(stdin, self._read_answer, stdin)
        try:
            yield
        finally:
            loop.remove_reader(stdin)

    def _read_answer(self, stdin: int) -> None:
        answer = os.read(stdin, 256).decode(errors="replace").strip().lower()
        if not confirms(answer, self._core.pending.digits):
            self._node.stop(EnrollmentOver("the digits were not confirmed", "nothing was accepted"))
            return
        with suppress(HintedError):  # the session gets the error from the node
            self._node.confirm(self._core.pending.digits, self._activate)

    def _pending(self) -> enrollment_control.Answer:
        pending = self._core.pending
        anchor = pending.anchor
        return {"digits": pending.digits, "domain": anchor.domain, "authority": fingerprint(anchor)}

    def _handle_control(self, request: enrollment_control.Answer) -> enrollment_control.Answer:
        if request.get("do") == "confirm":
            self._node.confirm(str(request.get("digits")), self._activate)
            return {}
        return self._pending()

    def _activate(self, pending: Pending) -> None:
        self._home.install(to_pem(*pending.chain, pending.root), now())


def is_live() -> bool:
    return sys.stderr.isatty()


def authority_lines(pending: enrollment_control.Answer) -> list[str]:
    return [
        f"authority of {printable(pending['domain'])}, fingerprint {pending['authority']}",
        f"digits {group_digits(pending['digits'])}",
    ]


def confirms(answer: str, digits: str) -> bool:
    """Whether `answer` to "the same digits?" is yes; who types the right ones has compared them."""
    return answer in {"y", "yes"} or re.sub("[ -]", "", answer) == digits


@click.command()
@click.argument("name")
@click.argument("digits", nargs=-1)
@flag("--yes", "without DIGITS: do not ask, as a button that was pressed")
@json_result(pass_environment)
def confirm(environment: Environment, name: str, digits: tuple[str, ...], yes: bool) -> None:
    """Confirm that the authority shows DIGITS for NAME, whose enrollment waits in another process.

    Without DIGITS they are shown here and you are asked.
    """
    home = NodeHome.of(environment.home, name)
    given = re.sub("[ -]", "", "".join(digits))
    if not given:
        waiting = enrollment_control.ask(home.path, {"do": "show"})
        given = waiting["digits"]
        for line in authority_lines(waiting):
            say(line)
        if not yes:
            # Raises ConfigurationError unless the answer is yes, or the digits themselves.
            try:
                answer: str = click.prompt(f"{SAME_DIGITS} [y/N]", default="n", show_default=False, err=True)
            except click.Abort as abort:
                reraise_interrupt(abort)
                answer = "n"
            if not confirms(answer.strip().lower(), given):
                raise ConfigurationError("the digits were not confirmed", "nothing was accepted")
    if _DIGITS.fullmatch(given) is None:
        raise ConfigurationError("the authority shows six digits", f"rossec node confirm {name} 123 456")
    enrollment_control.ask(home.path, {"do": "confirm", "digits": given})
    say(f"{name} is enrolled", name=name)


@click.command()
@click.argument("names", nargs=-1, required=True)
@options.domain
@option("--out", "HTML file to print", type=PATH, required=True)
@json_result(pass_environment)
def labels(environment: Environment, names: tuple[str, ...], domain: str, out: Path) -> None:
    """Write a sheet of labels for the nodes NAMES, 24 to a page; makes keys that are missing.

    A label holds no secret: it names the key of the node that carries it.
    """
    made = []
    for name in names:
        csr = NodeHome.of(environment.home, name).label_request(domain)
        key = check_request(csr, domain).thumbprint
        made.append(qr.Label(name, format_fingerprint(key), qr.label_code(csr)))
    files.replace(out, qr.sheet(made).encode(), 0o644)
    record(names=[each.name for each in made], file=str(out))
    say(f"{len(made)} label{'s' * (len(made) != 1)} in {out}: print it without scaling")


@click.command("join")
@option("--file path", "read the code from this file: the line, or an NFC tag (NDEF)", type=FILE)
@option("--name", "the node's name, if the invitation is for more than one")
@option(
    "--meta=FILE meta_path",
    "the node's metadata: take the name that the authority's rules give for them",
    type=FILE,
)
@json_result(pass_environment)
def join_domain(
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
    # Run again, it is done: a boot script may call it at each start.
    if _is_enrolled(home, code):
        say(f"{home.name} is enrolled already", name=home.name, joined=False)
        return
    if not (home.path / "node.key").exists():
        code.check_time(now())  # a second run may be late: its request may have its answer
    wildcard = code.wildcard
    found = asyncio.run(join(code, partial(home.join_request, wildcard=wildcard), now, metadata))
    identity = home.install(to_pem(*found.chain, found.root), now())
    record(name=home.name, joined=True, domain=identity.domain, expires=identity.not_after)
    say(f"authority of {identity.domain}, fingerprint {fingerprint(found.anchor)}")
    tail = f" and {home.name}_*" if wildcard else ""
    say(f"{home.name}{tail} is enrolled until {clock.format_time(identity.not_after)}")


def _code(path: Path | None, stdin: BinaryIO) -> invitation.InvitationCode:
    # The code from the file, or from standard input; from a terminal it is not shown.
    if path is not None:
        if path.is_file() and path.stat().st_mode & 0o077:
            note(f"{path} can be read by other users, who could join by it: chmod 600 {path}")
        return _parsed(files.read(path, _MAX_INPUT))
    if not sys.stdin.isatty():
        return _parsed(stdin.read(_MAX_INPUT + 1))

    def is_whole(typed: str) -> bool:
        # A mail or a chat may have broken the line of the code.
        try:
            invitation.parse(typed)
        except CodeRefused:
            return False
        return True

    typed = read_lines("the line of `rossec ca invite` (it is not shown)", is_whole)
    if not typed.strip():
        raise ConfigurationError("no code was given", "paste the line, or give --file")
    return invitation.parse(typed)


def _parsed(data: bytes) -> invitation.InvitationCode:
    if invitation.is_message(data):
        return invitation.read(data)
    try:
        return invitation.parse(data.decode())
    except UnicodeDecodeError:
        raise CodeRefused(
            "this is not the code of an invitation", "give the line of `rossec ca invite`"
        ) from None


def _name(code: invitation.InvitationCode, given: str | None) -> str:
    pattern = code.pattern
    if given is None:
        if "*" in pattern:
            raise ConfigurationError(
                f"the invitation is for all names {pattern}: which is this node's?",
                f"give it: --name {pattern.replace('**', 'robot07').replace('*', 'robot07')}",
            )
        return pattern
    # `/ca` and `/master` are what nodes trust most: a person gives them (attack `join-name`).
    if is_reserved(given):
        raise ConfigurationError(
            f"{given} is reserved: no invitation is for it",
            f"enroll it in person: rossec node enroll {given}",
        )
    if not pattern_covers(pattern, given):
        raise ConfigurationError(
            f"the invitation is not for {given}, but for {pattern}",
            "give another name, or ask for another invitation: rossec ca invite PATTERN",
        )
    return given


def _is_enrolled(home: NodeHome, code: invitation.InvitationCode) -> bool:
    if not (home.path / "ca.pem").exists():
        return False
    # Another root would be another authority: nothing here is replaced by a code (attack `join-impostor`).
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
