"""`rossec node enroll | confirm | labels`: a node is enrolled by its code, over the network."""

import asyncio
import re
import secrets
from pathlib import Path

import click

from ca.enrollment import NONCE_SIZE, WINDOW, qr
from ca.enrollment.labels import Label, sheet
from ca.enrollment.node import NodeEnrollment
from ca.requests import check_request
from rossec import files
from rossec.authority.home import format_fingerprint
from rossec.cli.node.enroll_screen import (
    SAME_DIGITS,
    EnrollmentScreen,
    authority_lines,
    confirms,
)
from rossec.cli.shared.context import (
    Duration,
    Environment,
    now,
    pass_environment,
    reraise_interrupt,
)
from rossec.cli.shared.own_address import own_address
from rossec.cli.shared.results import json_result
from rossec.enrollment import address, control
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.terminal import record, say

_DIGITS = re.compile(r"[0-9]{6}", re.ASCII)


@click.command()
@click.argument("name")
@click.option("--domain", default="home", show_default=True, help="trust domain of the authority")
@click.option("--anonymous", is_flag=True, help="for anonymous nodes too: NAME and NAME_*")
@click.option("--label", is_flag=True, help="wait for an authority that read the printed label")
@click.option("--address", "host", help="the address in the code, instead of the one found")
@click.option("--port", type=click.IntRange(0, 65535), help="listen here [any; a label's is 11317]")
@click.option("--for", "window", type=Duration(1), help="with --label: wait so long [15m]")
@click.option("--png", type=click.Path(path_type=Path), help="write the code to this PNG file too")
@click.option("--svg", type=click.Path(path_type=Path), help="write the code to this SVG file too")
@json_result()
@pass_environment
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
    listen = port if port is not None else address.DEFAULT_PORT * label
    asyncio.run(EnrollmentScreen(home, core, label=label, png=png, svg=svg).run(where, listen))
    record(name=home.name, domain=domain, path=str(home.path))


@click.command()
@click.argument("name")
@click.argument("digits", nargs=-1)
@click.option(
    "--yes", is_flag=True, help="without DIGITS: do not ask, as a button that was pressed"
)
@json_result()
@pass_environment
def confirm(environment: Environment, name: str, digits: tuple[str, ...], yes: bool) -> None:
    """Confirm that the authority shows DIGITS for NAME, whose enrollment waits in another process.

    Without DIGITS they are shown here and you are asked.
    """
    home = NodeHome.of(environment.home, name)
    given = re.sub("[ -]", "", "".join(digits))
    if not given:
        waiting = control.ask(home.path, {"do": "show"})
        given = waiting["digits"]
        for line in authority_lines(waiting):
            say(line)
        if not yes:
            _ask_whether_same(given)
    if _DIGITS.fullmatch(given) is None:
        raise ConfigurationError(
            "the authority shows six digits", f"rossec node confirm {name} 123 456"
        )
    control.ask(home.path, {"do": "confirm", "digits": given})
    record(name=name)
    say(f"{name} is enrolled")


def _ask_whether_same(digits: str) -> None:
    """Raises ConfigurationError unless the answer is yes, or the digits themselves."""
    try:
        answer: str = click.prompt(
            f"{SAME_DIGITS} [y/N]", default="n", show_default=False, err=True
        )
    except click.Abort as abort:
        reraise_interrupt(abort)
        answer = "n"
    if not confirms(answer.strip().lower(), digits):
        raise ConfigurationError("the digits were not confirmed", "nothing was accepted")


@click.command()
@click.argument("names", nargs=-1, required=True)
@click.option("--domain", default="home", show_default=True, help="trust domain of the authority")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="HTML file to print")
@json_result()
@pass_environment
def labels(environment: Environment, names: tuple[str, ...], domain: str, out: Path) -> None:
    """Write a sheet of labels for the nodes NAMES, 24 to a page; makes keys that are missing.

    A label holds no secret: it names the key of the node that carries it.
    """
    made = []
    for name in names:
        csr = NodeHome.of(environment.home, name).label_request(domain)
        key = check_request(csr, domain).thumbprint
        made.append(Label(name, format_fingerprint(key), qr.label_code(csr)))
    files.replace(out, sheet(made).encode(), 0o644)
    record(names=[each.name for each in made], file=str(out))
    say(f"{len(made)} label{'s' * (len(made) != 1)} in {out}: print it without scaling")
