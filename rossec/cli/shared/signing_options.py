"""Options of the commands that sign identities."""

from collections.abc import Callable
from typing import Any

import click

from ca.authority import DAY, MAX_LIFETIME
from rossec.cli.shared.context import Duration

identity_lifetime = click.option(
    "--for", "lifetime", type=Duration(MAX_LIFETIME // DAY), default="30d", show_default=True,
    help="how long the identity lasts",
)  # fmt: skip
anonymous = click.option(
    "--anonymous", is_flag=True,
    help="for anonymous nodes too: /rviz also as /rviz_1234_1700000000000",
)  # fmt: skip


def replace_key(*, multiple: bool = False) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Add `--replace-key` to a command that signs one identity, or `multiple`."""
    return click.option(
        "--replace-key", "replaced", multiple=multiple, metavar="NAME",
        help="let the known name NAME come with another key; revokes the old one",
    )  # fmt: skip
