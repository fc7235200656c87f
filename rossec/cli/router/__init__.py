"""`rossec router`: what relays of several sites reach each other through."""

from pathlib import Path
from typing import Final

import click

from rossec.cli.shared.context import Environment, LazyGroup, pass_environment
from rossec.cli.shared.options import FOLDER, flag, option

_ROUTER: Final = {"accounts": "router:accounts", "share": "relay.sites:share", "take": "relay.sites:take"}
_ACCOUNTS: Final = {
    "add": ("relay.sites:add_account", "free"),
    "list": "relay.sites:list_accounts",
    "remove": ("relay.sites:remove_account", "free"),
    "show": ("relay.sites:show_account", "free"),
}


@click.group(cls=LazyGroup, table=_ROUTER, invoke_without_command=True)
@option("--home directory", "the router's directory, by default `router` in ROSSEC_HOME", type=FOLDER)
@option(
    "--listen=LOCATOR",
    "where it listens, tls/[::]:7447 by default; also quic/ and tcp/; may be repeated",
    multiple=True,
)
@option(
    "--join=LOCATOR",
    "another router of this operator, tls/other.example.org:7447; may be repeated",
    multiple=True,
)
@option(
    "--host=NAME",
    "name or address by which relays reach it, for its certificate; may be repeated",
    multiple=True,
)
@flag("--open is_open", "let in everybody, without accounts")
@flag("--print-config", "print it for a stock zenohd, and end")
@flag("--json as_json", "say where it listens as a line of JSON")
@pass_environment
@click.pass_context
def router(
    context: click.Context,
    environment: Environment,
    directory: Path | None,
    listen: tuple[str, ...],
    join: tuple[str, ...],
    host: tuple[str, ...],
    is_open: bool,
    print_config: bool,
    as_json: bool,
) -> None:
    """Run a router, through which relays of several sites reach each other. Ends with Ctrl-C.

    It learns random inboxes, sizes and times, nothing else. --listen, --join and --host are kept
    for the next start. An account that is added or removed while it runs is taken over at once.
    """
    from rossec.cli.relay.sites import home_of  # noqa: PLC0415 - imported when it runs

    home = home_of(environment, directory)
    given = {"listen": listen, "join": join, "hosts": host}
    if context.invoked_subcommand is not None:
        if any(given.values()) or is_open or print_config or as_json:
            raise click.UsageError("only --home stands before a verb")
        context.obj = home
        return
    from rossec.cli.router.serve import print_settings, run  # noqa: PLC0415 - as above

    if print_config:
        print_settings(home, given, is_open=is_open)
        return
    run(environment, home, given, is_open=is_open, as_json=as_json)


@click.group(cls=LazyGroup, table=_ACCOUNTS)
def accounts() -> None:
    """Say who may use the router, and make the files for relays.

    An account is for one site: its relay reads the inboxes of its account, and sends to any that it
    knows. A router that runs takes changes over within a second.
    """
