"""`rossec policy init`: the beginning of a policy."""

from pathlib import Path

import click

from grants.policy.beginning import beginning
from rossec import files
from rossec.authority.policyfile import parse_policy, place
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.results import json_result
from rossec.errors import ConfigurationError
from rossec.terminal import record, say


@click.command()
@click.argument("file", required=False, type=click.Path(path_type=Path))
@click.option("--robot", default="home", help="its name, for people  [default: home]")
@json_result()
@pass_environment
def init(environment: Environment, file: Path | None, robot: str) -> None:
    """Write the commented beginning of a policy to FILE, which must not exist.

    It gives every node what every ROS program needs (`basics`), and nothing else.
    """
    path = place(environment.home, file)
    if not path.parent.is_dir():
        raise ConfigurationError(
            f"there is no {path.parent}",
            "name a file, or create an authority: rossec ca init DOMAIN",
        )
    text = beginning(robot)
    parse_policy(text, str(path))
    files.create(path, text.encode(), 0o644)
    record(file=str(path))
    say(f"{path} is begun; write rules, then: rossec policy check {path}")
