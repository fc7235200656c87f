"""Options that several commands share: which policy, and how an identity is signed."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from ca.authority import DAY, MAX_LIFETIME
from rossec.authority.policyfile import PolicyFile, place
from rossec.cli.shared.context import Duration, Environment


def policy(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add `--policy` to a command."""
    return click.option(
        "--policy",
        "policy_path",
        type=click.Path(path_type=Path, dir_okay=False),
        help="this policy, instead of ca/policy.yaml in ROSSEC_HOME",
    )(command)


def identity_lifetime(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add `--for` to a command that signs identities."""
    return click.option(
        "--for",
        "lifetime",
        type=Duration(MAX_LIFETIME // DAY),
        default="30d",
        show_default=True,
        help="how long the identity lasts",
    )(command)


def replace_key(*, multiple: bool = False) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Add `--replace-key` to a command that signs one identity, or `multiple`."""
    return click.option(
        "--replace-key",
        "replaced",
        multiple=multiple,
        metavar="NAME",
        help="let the known name NAME come with another key; revokes the old one",
    )


def anonymous(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add `--anonymous` to a command that signs identities."""
    return click.option(
        "--anonymous",
        is_flag=True,
        help="for anonymous nodes too: /rviz also as /rviz_1234_1700000000000",
    )(command)


def master_to_tell(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add `--master` to a command whose revocations are to be known at once."""
    return click.option("--master", "master_uri", help="master to tell, instead of ROS_MASTER_URI")(
        command
    )


def read_policy(environment: Environment, given: Path | None, *, signs: bool = False) -> PolicyFile:
    """The policy a command is about.

    Args:
        environment: with the home.
        given: another file than the one in force.
        signs: grants are signed by it, so nobody else may be able to write it.

    Raises:
        ConfigurationError, PolicyRefused: there is none, or it has mistakes.
        PathRefused: somebody else could have written what is, or is to be, in force.
    """
    return PolicyFile.read(place(environment.home, given), own=signs or given is None)
