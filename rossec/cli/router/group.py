"""The groups `rossec router`, which runs a router between sites, and `rossec router seats`."""

from pathlib import Path
from typing import Final

import click

from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.lazy import LazyGroup

_ROUTER: Final = {
    "seats": ("router.group:seats", "Say who may use the router, and make the files for relays."),
    "share": ("router.sharing:share", "Write what another router of the operator needs to join."),
    "take": ("router.sharing:take", "Take over FILE of `share` here, and join that router."),
}

_SEATS: Final = {
    "add": (
        "router.seats:add",
        "Make the seat NAME, and print its file for the relay of that site.",
    ),
    "list": ("router.seats:list_", "List the seats."),
    "remove": (
        "router.seats:remove",
        "Take the seat NAME away; a router that runs cuts its relay off within a second.",
    ),
    "show": (
        "router.seats:show",
        "Print the file of the seat NAME again, with the routers of now.",
    ),
}


@click.group(cls=LazyGroup, table=_ROUTER, invoke_without_command=True)
@click.option(
    "--home", "directory", type=click.Path(path_type=Path, file_okay=False),
    help="the router's directory, by default `router` in ROSSEC_HOME",
)  # fmt: skip
@click.option(
    "--listen", metavar="LOCATOR", multiple=True,
    help="where it listens, tls/[::]:7447 by default; also quic/ and tcp/; may be repeated",
)  # fmt: skip
@click.option(
    "--join", metavar="LOCATOR", multiple=True,
    help="another router of this operator, tls/other.example.org:7447; may be repeated",
)  # fmt: skip
@click.option(
    "--host", metavar="NAME", multiple=True,
    help="name or address by which relays reach it, for its certificate; may be repeated",
)  # fmt: skip
@click.option("--open", "is_open", is_flag=True, help="let in everybody, without seats")
@click.option("--print-config", is_flag=True, help="print it for a stock zenohd, and end")
@click.option("--json", "as_json", is_flag=True, help="say where it listens as a line of JSON")
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

    It learns random mailboxes, sizes and times, nothing else. --listen, --join and --host are kept
    for the next start. A seat that is added or removed while it runs is taken over at once.
    """
    from rossec.cli.router.home import home_of  # noqa: PLC0415 - imported when it runs

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


@click.group(cls=LazyGroup, table=_SEATS)
def seats() -> None:
    """Say who may use the router, and make the files for relays.

    A seat is for one site: its relay reads the mailboxes of its seat, and sends to any that it
    knows. A router that runs takes changes over within a second.
    """
