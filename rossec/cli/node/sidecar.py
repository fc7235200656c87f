"""`rossec sidecar | run`: secure programs that were not written for rossec, of a host or one."""

import json
import os
import pwd
import signal
import sys

import click

from ca.names import check_name
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.options import flag, option

_LAST_USER = (1 << 32) - 2  # the last number means "no user"


@click.command(context_settings={"allow_interspersed_args": False})
@option("--as=NAME identity", "the identity all its nodes use")
@flag("--each", "nodes that are enrolled use their own identity")
@click.argument("command", nargs=-1, required=True, type=click.UNPROCESSED)
@click.pass_context
@pass_environment
def run(
    environment: Environment,
    context: click.Context,
    identity: str | None,
    each: bool,
    command: tuple[str, ...],
) -> None:
    """Run COMMAND, a ROS program in any language, behind a sidecar of its own.

    Without --as each node uses the identity that is enrolled for its name. Ends as COMMAND does.
    """
    exec_sidecar(environment, context, identity=identity, each=each or identity is None, command=command)


def exec_sidecar(
    environment: Environment,
    context: click.Context,
    *,
    identity: str | None,
    each: bool,
    command: tuple[str, ...] = (),
    port: int = 0,
    users: list[int] | None = None,
) -> None:
    """Replace this process: the sidecar needs a fraction of what the command line has loaded."""
    options = {
        "identity": None if identity is None else check_name(identity),
        "each": each,
        "command": list(command),
        "port": port,
        "users": users or [],
        "verbose": bool(context.find_root().params.get("verbose")),
    }
    # Isolated: neither PYTHONPATH nor the directory of the program chooses what the keys are given to.
    arguments = [sys.executable, "-I", "-m", "rossec.sidecar", json.dumps(options)]
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # until it can end quietly
    try:
        os.execve(sys.executable, arguments, dict(environment.variables))  # noqa: S606 - no shell
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@click.command()
@option("--as=NAME identity", "for nodes that are not enrolled themselves")
@option(
    "--port -p",
    "where programs find their master on this host",
    type=click.IntRange(0, 65535),
    default=11311,
    show_default=True,
)
@option("--user users", "whose programs may use it, by default yours", multiple=True)
@click.pass_context
@pass_environment
def sidecar(
    environment: Environment, context: click.Context, identity: str | None, port: int, users: tuple[str, ...]
) -> None:
    """Serve the ROS programs of this host: each node with the identity enrolled for its name."""
    exec_sidecar(
        environment,
        context,
        identity=identity,
        each=True,
        port=port,
        users=[_user_id(name) for name in users],
    )


def _user_id(name: str) -> int:
    # A number need not be in the password file, as of users of containers.
    try:
        found = int(name) if name.isdecimal() else pwd.getpwnam(name).pw_uid
    except KeyError:
        raise click.BadParameter(f"no user {name!r} on this host") from None
    if found > _LAST_USER:
        raise click.BadParameter(f"{name} is no user id")
    return found
