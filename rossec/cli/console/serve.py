"""`rossec console`: the pages, as long as it runs."""

import asyncio
import os
import socket
from importlib.util import find_spec
from typing import Final

from rossec.authority.console.messages import SOCKET
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.client import KeyServiceClient
from rossec.cli.console.service import login_address, running_service, show_code
from rossec.cli.shared.context import Environment
from rossec.console.address import remove_address, write_address
from rossec.console.options import Options, read_options
from rossec.errors import ConfigurationError
from rossec.operation.json_log import log_as_json
from rossec.operation.systemd import READY, STOPPING, notify
from rossec.terminal import say, say_json

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


def serve(environment: Environment, options: Options, *, log: str, as_json: bool) -> None:
    """Run the console until it is interrupted.

    Raises:
        ConfigurationError: a library or the service is missing, or it cannot listen.
    """
    check_libraries()
    from rossec.console.server.supervisor import settings_for, supervise  # noqa: PLC0415 - extra
    from rossec.console.server.web_process import WebOptions  # noqa: PLC0415

    if log == "json":
        log_as_json()
    endpoint = read_options(options, socket.gethostname())
    home = AuthorityHome.at(environment.home)
    client = running_service(home)
    web = WebOptions(settings_for(endpoint, home.domain), home.path / SOCKET, log)

    def ready() -> None:
        write_address(home.path, endpoint.origin)
        _say_ready(client, endpoint.origin, as_json=as_json)
        notify(READY, environment.variables)

    try:
        asyncio.run(supervise(endpoint, web, environment.variables, ready))
    finally:
        notify(STOPPING, environment.variables)
        remove_address(home.path)
        client.close()


def _say_ready(client: KeyServiceClient, origin: str, *, as_json: bool) -> None:
    address = login_address(origin, client.phone_code())
    if as_json:
        say_json({"ready": origin, "login": address, "process": os.getpid()})
        return
    show_code(address)
    say(f"the console is at {origin}; Ctrl-C ends it")
