"""`rossec relay`: connections of nodes, carried to other sites."""

from pathlib import Path
from typing import Final

import click

from rossec.cli.shared.context import Environment, LazyGroup, pass_environment
from rossec.cli.shared.options import NEW_FILE, flag, option

_RELAY: Final = {
    "add": ("relay.sites:add_relay", "free"),
    "descriptor": ("relay.sites:descriptor", "free"),
    "list": "relay.sites:list_relays",
    "remove": ("relay.sites:remove_relay", "free"),
    "account": "relay.sites:account",
    "status": "status:relay_status",
}


@click.group(cls=LazyGroup, table=_RELAY, invoke_without_command=True)
@option(
    "--bind=ADDRESS",
    "listen here for nodes of other hosts of this site; default: loopback, for this user",
    default="",
)
@option(
    "--account=FILE account_file",
    "the routers and the account there, instead of what `rossec relay account` keeps",
    type=NEW_FILE,
)
@option("--name=NAME", "which of the domain's relays: /relay, or /relay/attic; instead of ROSSEC_RELAY")
@flag("--json as_json", "say that it runs as a line of JSON")
@pass_environment
@click.pass_context
def relay(
    context: click.Context,
    environment: Environment,
    bind: str,
    account_file: Path | None,
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
        if bind or account_file is not None or as_json:
            raise click.UsageError("only --name stands before a verb")
        return
    from rossec.cli.relay.serve import run  # noqa: PLC0415 - imported when it runs

    run(environment, bind, account_file, as_json=as_json)
