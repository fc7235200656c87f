"""`rossec ca unlock | lock | status`: the service that runs in the authority's directory."""

import time
from contextlib import closing
from pathlib import Path

import click

from ca.encoding import Value
from rossec import clock
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.client import KeyServiceClient
from rossec.authority.keyservice.messages import MAX_UNLOCKED
from rossec.cli.ca.serve import describe_remaining
from rossec.cli.shared import passphrase
from rossec.cli.shared.context import Environment, UnlockTime, pass_environment
from rossec.cli.shared.results import json_result
from rossec.errors import ConfigurationError
from rossec.terminal import record, say, say_json

_START = "start it with: rossec ca serve"
_STARTING = 3.0  # seconds: `rossec ca serve &` and `rossec ca unlock` may be pasted together
_PAUSE = 0.1


@click.command()
@click.option(
    "--for", "seconds", type=UnlockTime(MAX_UNLOCKED), default="15m", show_default=True,
    help="how long the key is held; 0: while the service runs",
)  # fmt: skip
@passphrase.option
@json_result()
@pass_environment
def unlock(environment: Environment, seconds: int, passphrase_file: Path | None) -> None:
    """Give the running service the passphrase: it holds the key from now on, for a time.

    Waits some seconds for a service that is starting.
    """
    with closing(_running(environment, wait=_STARTING)) as client:
        secret = passphrase.read(passphrase_file, environment.variables)
        found = client.unlock(secret, seconds)
        record(**found)
        say(_describe(found))


@click.command()
@json_result()
@pass_environment
def lock(environment: Environment) -> None:
    """Let the running service drop the key at once."""
    with closing(_running(environment)) as client:
        found = client.lock()
        record(**found)
        say(_describe(found))


@click.command()
@click.option("--json", "as_json", is_flag=True, help="one line of JSON")
@pass_environment
def status(environment: Environment, as_json: bool) -> None:
    """Show whether the authority's service runs, and whether it holds the key."""
    client = KeyServiceClient.find(AuthorityHome.at(environment.home).path)
    found = None
    if client is not None:
        with closing(client):
            found = client.status()
    if as_json:
        say_json({"running": False} if found is None else {"running": True, **found})
    elif found is None:
        say(f"no service runs, each command asks for the passphrase; {_START}")
    else:
        say(_describe(found))


def _running(environment: Environment, wait: float = 0) -> KeyServiceClient:
    """The service that runs, or will within `wait` seconds."""
    directory, seconds = AuthorityHome.at(environment.home).path, clock.counter()
    until = seconds() + wait
    while (client := KeyServiceClient.find(directory)) is None:
        if seconds() >= until:
            raise ConfigurationError("the authority's service does not run", _START)
        time.sleep(_PAUSE)
    return client


def _describe(found: dict[str, Value]) -> str:
    remaining = found.get("remaining")
    state = describe_remaining(remaining if isinstance(remaining, int) else None)
    return f"authority of {found.get('domain')!s}: {state}"
