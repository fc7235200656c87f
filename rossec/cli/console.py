"""`rossec console | console tls`: the pages, as long as it runs, and its own TLS authority."""

import asyncio
import os
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager, nullcontext
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rossec.authority.console.messages import SOCKET
from rossec.authority.home import AuthorityHome
from rossec.cli.phones import login_address, running_service, show_code
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.console import tls as own_tls
from rossec.console.listening import only_console, write_address
from rossec.console.options import (
    HAND_OUT_PORT,
    ConsoleEndpoint,
    ConsoleOptions,
    check_name,
    check_origin,
    read_options,
)
from rossec.console.tls import certificates
from rossec.errors import ConfigurationError
from rossec.host.runner import READY, STOPPING, log_as_json, notify
from rossec.terminal import say, say_block, say_json

if TYPE_CHECKING:
    from rossec.console.server import PreviewProcess


def check_libraries() -> None:
    missing = [name for name in ("fido2", "jinja2", "starlette", "uvicorn") if find_spec(name) is None]
    if missing:
        raise ConfigurationError(
            f"the console needs libraries that are not installed: {', '.join(missing)}",
            "pip install 'rossec[console]'",
        )


def serve(
    environment: Environment, options: ConsoleOptions, *, rename: bool, log: str, as_json: bool
) -> None:
    """Run the console until it is interrupted; `log` is the form of its log."""
    check_libraries()
    from rossec.console.server import WebOptions, settings_for, supervise  # noqa: PLC0415 - extra

    if log == "json":
        log_as_json()
    endpoint = read_options(options, socket.gethostname())
    home = AuthorityHome.at(environment.home)
    # A passkey is bound to the origin it was made at: another name would end every phone's (WebAuthn).
    if not endpoint.read_only:  # nobody approves there
        check_origin(endpoint, origins_of_phones(home), rename=rename)
    setup = own_tls.prepare_tls(endpoint, home.path / own_tls.DIRECTORY, now(), rename=rename)
    with closing(running_service(home)) as client, _ending(home, environment, endpoint):
        web = WebOptions(settings_for(endpoint, home.domain), home.path / SOCKET, log)

        def ready() -> None:
            if not endpoint.read_only:  # the codes of `rossec console phone` are for the other one
                write_address(home.path, endpoint.origin)
            authority = None if setup is None else setup.authority
            address = login_address(endpoint.origin, client.phone_code())
            if as_json:
                about = {} if authority is None else {"tls": own_tls.as_json(authority)}
                say_json({"ready": endpoint.origin, "login": address, "process": os.getpid(), **about})
            else:
                _say_authority(authority, endpoint)
                show_code(address)
                say(f"the console is at {endpoint.origin}; Ctrl-C ends it")
            notify(READY, environment.variables)

        certificates = None if setup is None else own_tls.renewed_from(setup.source, now)
        preview = _preview(environment) if options.preview else None
        with _handing_out(endpoint, setup, environment):
            asyncio.run(supervise(endpoint, web, environment.variables, ready, certificates, preview))


def origins_of_phones(home: AuthorityHome) -> set[str]:
    with closing(home.store()) as store:
        return {passkey.origin for passkey in store.passkeys.active()}


def _preview(environment: Environment) -> "PreviewProcess":
    from rossec.console.server import PreviewProcess, check_enrolled  # noqa: PLC0415 - heavy

    check_enrolled(environment.home)
    return PreviewProcess({**environment.variables, "ROSSEC_HOME": str(environment.home)})


@contextmanager
def _ending(home: AuthorityHome, environment: Environment, endpoint: ConsoleEndpoint) -> Iterator[None]:
    with nullcontext() if endpoint.read_only else only_console(home.path):
        try:
            yield
        finally:
            notify(STOPPING, environment.variables)


@contextmanager
def _handing_out(
    endpoint: ConsoleEndpoint, setup: own_tls.TlsSetup | None, environment: Environment
) -> Iterator[None]:
    if not endpoint.hand_out or setup is None or setup.authority is None:
        yield
        return
    from rossec.console.tls.hand_out import handing_out  # noqa: PLC0415 - the extra

    certificate, addresses = setup.authority.data, endpoint.addresses
    with handing_out(certificate, endpoint.origin, addresses, environment.variables):
        yield


def _say_authority(authority: own_tls.TlsAuthority | None, endpoint: ConsoleEndpoint) -> None:
    # What a person needs whose phone does not trust it yet.
    if authority is None:
        return
    for line in own_tls.describe(authority, now()):
        say(line)
    if not endpoint.hand_out:
        say("a phone that does not trust it yet: start with --hand-out")
        return
    say("for ten minutes a phone gets the certificate, and how to install it, at")
    say(f"    http://{endpoint.name}:{HAND_OUT_PORT}/")
    say_block("compare the fingerprint before you trust it: that page is not protected\n")


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
    options.say_result(as_json, own_tls.as_json(authority), [*own_tls.describe(authority, now()), *install])


def _name(directory: Path, given: str | None) -> str:
    if given is not None:
        return check_name(given)
    try:
        return certificates.open_authority(directory).name
    except ConfigurationError:  # none, or a damaged one
        return read_options(ConsoleOptions(lan=True), socket.gethostname()).name
