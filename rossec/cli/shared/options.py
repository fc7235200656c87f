"""Options and parameter types that several commands share."""

from pathlib import Path
from typing import Final

import click

MAX_PEM: Final = 64 * 1024
FILE: Final = click.Path(path_type=Path, exists=True, dir_okay=False)

policy = click.option(
    "--policy", "policy_path", type=click.Path(path_type=Path, dir_okay=False),
    help="this policy, instead of ca/policy.yaml in ROSSEC_HOME",
)  # fmt: skip
master_uri = click.option(
    "--master", "master_uri", metavar="URI",
    help="master to notify, instead of ROS_MASTER_URI; discover: finds it",
)  # fmt: skip
