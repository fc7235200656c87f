"""`rossec console tls`: the console's own TLS authority."""

import socket
from pathlib import Path

import click

from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.console.options import ConsoleOptions, check_name, read_options
from rossec.console.tls import as_json as described
from rossec.console.tls import certificates, describe
from rossec.errors import ConfigurationError


@click.command()
@options.flag("--renew", "make a new one, which every phone must install anew")
@options.option("--name", "DNS name of this host for --renew; by default as before")
@options.as_json
@pass_environment
def tls(environment: Environment, renew: bool, name: str | None, as_json: bool) -> None:
    """Show the console's own TLS authority (--lan): its fingerprint, in words and hex.

    It is valid for a year. A console that runs uses a new one when it is started again.
    """
    if name is not None and not renew:
        raise click.UsageError("--name is for --renew")
    directory = environment.home / "ca" / certificates.DIRECTORY
    if renew:
        authority = certificates.renew(directory, _name(directory, name), certificates.first_address(), now())
    else:
        authority = certificates.open_authority(directory)
    install = ["install it on every phone: rossec console --lan --hand-out"] if renew else []
    options.say_result(as_json, described(authority), [*describe(authority, now()), *install])


def _name(directory: Path, given: str | None) -> str:
    if given is not None:
        return check_name(given)
    try:
        return certificates.open_authority(directory).name
    except ConfigurationError:  # none, or a damaged one
        return read_options(ConsoleOptions(lan=True), socket.gethostname()).name
