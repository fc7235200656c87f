"""`rossec master status | stop`: ask the running master at its administrator's port."""

from typing import Final

import click

from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.results import json_result
from rossec.environment import own_master
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.home_hints import missing_node
from rossec.master.operation.admin import send_command
from rossec.terminal import printable, record, say, say_json

ADMIN_SOCKET: Final = "admin.sock"


@click.command()
@click.option("--json", "as_json", is_flag=True, help="a line of JSON")
@pass_environment
def status(environment: Environment, as_json: bool) -> None:
    """Show the status of the running master; it must have been started with --admin."""
    answer = send_command(_home(environment).path / ADMIN_SOCKET, "status")
    if as_json:
        say_json(answer)
        return
    for key, value in answer.items():
        say(f"{key.replace('_', ' '):<20} {printable(str(value))}")


@click.command()
@json_result()
@pass_environment
def stop(environment: Environment) -> None:
    """Stop the running master in order; it must have been started with --admin."""
    send_command(_home(environment).path / ADMIN_SOCKET, "stop")
    record(stopping=True)
    say("the master ends")


def _home(environment: Environment) -> NodeHome:
    home = NodeHome.of(environment.home, own_master(environment.variables))
    if not home.path.is_dir():  # it cannot run from here: the terminal lacks ROSSEC_HOME, perhaps
        hint = missing_node(environment.home, home.name)
        raise ConfigurationError(f"there is no {home.name} in {environment.home}", hint)
    return home
