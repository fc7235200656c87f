"""`rossec sidecar`: secure the programs of a host that were not written for rossec."""

import pwd

import click

from rossec.cli.node.run import exec_sidecar
from rossec.cli.shared.context import Environment, pass_environment

_LAST_USER = (1 << 32) - 2  # the last number means "no user"


@click.command()
@click.option("--as", "identity", metavar="NAME", help="for nodes that are not enrolled themselves")
@click.option(
    "--port", "-p", type=click.IntRange(0, 65535), default=11311, show_default=True,
    help="where programs find their master on this host",
)  # fmt: skip
@click.option("--user", "users", multiple=True, help="whose programs may use it, by default yours")
@click.pass_context
@pass_environment
def sidecar(
    environment: Environment,
    context: click.Context,
    identity: str | None,
    port: int,
    users: tuple[str, ...],
) -> None:
    """Serve the ROS programs of this host: each node with the identity enrolled for its name."""
    exec_sidecar(
        environment, context, identity=identity, each=True, port=port,
        users=[_user_id(name) for name in users],
    )  # fmt: skip


def _user_id(name: str) -> int:
    """A number need not be in the password file, as of users of containers."""
    try:
        found = int(name) if name.isdecimal() else pwd.getpwnam(name).pw_uid
    except KeyError:
        raise click.BadParameter(f"no user {name!r} on this host") from None
    if found > _LAST_USER:
        raise click.BadParameter(f"{name} is no user id")
    return found
