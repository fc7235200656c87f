"""`rossec console`: the pages, as long as it runs."""

import asyncio
import os
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager, nullcontext
from importlib.util import find_spec
from typing import TYPE_CHECKING, Final, NamedTuple

from rossec.authority.console.messages import SOCKET
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.client import KeyServiceClient
from rossec.cli.console.service import login_address, running_service, show_code
from rossec.cli.shared.context import Environment, now
from rossec.console.address import only_console, write_address
from rossec.console.options import (
    HAND_OUT_PORT,
    Endpoint,
    Options,
    check_origin,
    read_options,
)
from rossec.console.tls.authority import TlsAuthority
from rossec.console.tls.description import as_json as described
from rossec.console.tls.description import describe
from rossec.console.tls.renewing import renewed_from
from rossec.console.tls.source import TlsSetup, prepare_tls
from rossec.console.tls.store import DIRECTORY
from rossec.errors import ConfigurationError
from rossec.operation.json_log import log_as_json
from rossec.operation.systemd import READY, STOPPING, notify
from rossec.terminal import say, say_block, say_json

if TYPE_CHECKING:
    from rossec.console.preview.supervisor import PreviewProcess

_LIBRARIES: Final = ("fido2", "jinja2", "starlette", "uvicorn")


def check_libraries() -> None:
    """Return if the libraries of the extra are there.

    Raises:
        ConfigurationError: one is missing.
    """
    missing = [name for name in _LIBRARIES if find_spec(name) is None]
    if missing:
        raise ConfigurationError(
            f"the console needs libraries that are not installed: {', '.join(missing)}",
            "pip install 'rossec[console]'",
        )


class Form(NamedTuple):
    """How it reports: the form of its log, and whether it says that it is ready as JSON."""

    log: str
    as_json: bool


def serve(environment: Environment, options: Options, form: Form, *, rename: bool) -> None:
    """Run the console until it is interrupted.

    Raises:
        ConfigurationError: a library or the service is missing, it cannot listen, or phones know
            it by another address and `rename` was not given.
    """
    check_libraries()
    from rossec.console.server.supervisor import settings_for, supervise  # noqa: PLC0415 - extra
    from rossec.console.server.web_process import WebOptions  # noqa: PLC0415

    if form.log == "json":
        log_as_json()
    endpoint = read_options(options, socket.gethostname())
    home = AuthorityHome.at(environment.home)
    if not endpoint.read_only:  # nobody approves there
        check_origin(endpoint, _origins_of_phones(home), rename=rename)
    setup = prepare_tls(endpoint, home.path / DIRECTORY, now(), rename=rename)
    with closing(running_service(home)) as client, _ending(home, environment, endpoint):
        web = WebOptions(settings_for(endpoint, home.domain), home.path / SOCKET, form.log)

        def ready() -> None:
            if not endpoint.read_only:  # the codes of `rossec console phone` are for the other one
                write_address(home.path, endpoint.origin)
            _say_ready(client, endpoint, setup, as_json=form.as_json)
            notify(READY, environment.variables)

        certificates = None if setup is None else renewed_from(setup.source, now)
        preview = _preview(environment) if options.preview else None
        with _handing_out(endpoint, setup, environment):
            asyncio.run(
                supervise(endpoint, web, environment.variables, ready, certificates, preview)
            )


def _preview(environment: Environment) -> "PreviewProcess":
    """Checked before anything listens.

    Raises:
        HintedError: the node of the preview is not enrolled here.
    """
    from rossec.console.preview.supervisor import (  # noqa: PLC0415 - few consoles have one
        PreviewProcess,
        check_enrolled,
    )

    check_enrolled(environment.home)
    return PreviewProcess({**environment.variables, "ROSSEC_HOME": str(environment.home)})


@contextmanager
def _ending(home: AuthorityHome, environment: Environment, endpoint: Endpoint) -> Iterator[None]:
    with nullcontext() if endpoint.read_only else only_console(home.path):
        try:
            yield
        finally:
            notify(STOPPING, environment.variables)


def _origins_of_phones(home: AuthorityHome) -> set[str]:
    with closing(home.store()) as store:
        return {passkey.origin for passkey in store.passkeys.active()}


@contextmanager
def _handing_out(
    endpoint: Endpoint, setup: TlsSetup | None, environment: Environment
) -> Iterator[None]:
    """Hand the certificate of the own authority out, if that was asked for."""
    if not endpoint.hand_out or setup is None or setup.authority is None:
        yield
        return
    from rossec.console.tls.hand_out_process import handing_out  # noqa: PLC0415 - the extra

    certificate, addresses = setup.authority.data, endpoint.addresses
    with handing_out(certificate, endpoint.origin, addresses, environment.variables):
        yield


def _say_ready(
    client: KeyServiceClient, endpoint: Endpoint, setup: TlsSetup | None, *, as_json: bool
) -> None:
    address = login_address(endpoint.origin, client.phone_code())
    authority = None if setup is None else setup.authority
    if as_json:
        about = {} if authority is None else {"tls": described(authority)}
        say_json({"ready": endpoint.origin, "login": address, "process": os.getpid(), **about})
        return
    if authority is not None:
        _say_authority(endpoint, authority)
    show_code(address)
    say(f"the console is at {endpoint.origin}; Ctrl-C ends it")


def _say_authority(endpoint: Endpoint, authority: TlsAuthority) -> None:
    """What a person needs whose phone does not trust the authority yet."""
    for line in describe(authority, now()):
        say(line)
    if not endpoint.hand_out:
        say("a phone that does not trust it yet: start with --hand-out")
        return
    say("for ten minutes a phone gets the certificate, and how to install it, at")
    say(f"    http://{endpoint.name}:{HAND_OUT_PORT}/")
    say_block("compare the fingerprint before you trust it: that page is not protected\n")
