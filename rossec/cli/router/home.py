"""The router's directory for the commands of its group."""

from pathlib import Path

import click

from rossec.cli.shared.context import Environment
from rossec.overlay.router_home import DIRECTORY, RouterHome

pass_home = click.make_pass_decorator(RouterHome)


def home_of(environment: Environment, directory: Path | None) -> RouterHome:
    """The directory that was given, else that in ROSSEC_HOME.

    Raises:
        PathRefused: others can write in ROSSEC_HOME.
    """
    found = environment.home / DIRECTORY if directory is None else directory.absolute()
    return RouterHome(found)
