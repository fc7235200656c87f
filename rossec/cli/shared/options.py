"""Options that several commands share: which policy, and which master."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click


def policy(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add `--policy` to a command."""
    return click.option(
        "--policy",
        "policy_path",
        type=click.Path(path_type=Path, dir_okay=False),
        help="this policy, instead of ca/policy.yaml in ROSSEC_HOME",
    )(command)


def master_uri(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add `--master` to a command that delivers a list to the master."""
    return click.option(
        "--master", "master_uri", help="master to notify, instead of ROS_MASTER_URI"
    )(command)
