"""The group `rossec relay`, which runs the relay of a site."""

from pathlib import Path
from typing import Final

import click

from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.lazy import LazyGroup

_RELAY: Final = {
    "add": ("relay.peers:add", "Take the card in FILE of another site's relay, and call it LABEL."),
    "card": (
        "relay.peers:card",
        "Print the card for the relay LABEL: the mailbox that it alone shall send to.",
    ),
    "list": ("relay.peers:list_", "List the relays of other sites, as cards have named them."),
    "remove": ("relay.peers:remove", "Link with LABEL no longer: its links end at once."),
    "seat": ("relay.seat:seat", "Keep the seat FILE that the operator of the routers made."),
    "status": ("relay.status:status", "Show the links of the running relay."),
}


@click.group(cls=LazyGroup, table=_RELAY, invoke_without_command=True)
@click.option(
    "--doors", metavar="ADDRESS", default="",
    help="listen here for nodes of other hosts of this site; default: loopback, for this user",
)  # fmt: skip
@click.option(
    "--seat", "seat_file", metavar="FILE",
    type=click.Path(path_type=Path, dir_okay=False),
    help="the routers and the seat there, instead of what `rossec relay seat` keeps",
)  # fmt: skip
@click.option(
    "--name", metavar="NAME",
    help="which of the domain's relays: /relay, or /relay/attic; instead of ROSSEC_RELAY",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="say that it runs as a line of JSON")
@pass_environment
@click.pass_context
def relay(
    context: click.Context,
    environment: Environment,
    doors: str,
    seat_file: Path | None,
    name: str | None,
    *,
    as_json: bool,
) -> None:
    """Run the relay of this site, as the node /relay. Ends with Ctrl-C.

    It carries connections of nodes to and from other sites, sealed as they are, through routers
    that learn nothing of them. It needs no port that is reachable from outside.
    """
    if name is not None:
        from rossec.environment import OWN_RELAY  # noqa: PLC0415 - not needed for help

        context.obj = environment = Environment({**environment.variables, OWN_RELAY: name})
    if context.invoked_subcommand is not None:
        if doors or seat_file is not None or as_json:
            raise click.UsageError("only --name stands before a verb")
        return
    from rossec.cli.relay.serve import run  # noqa: PLC0415 - imported when it runs

    run(environment, doors, seat_file, as_json=as_json)
