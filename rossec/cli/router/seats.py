"""`rossec router seats`: who may use the router."""

from collections.abc import Callable
from operator import methodcaller
from typing import Any

import click

from rossec.cli.router.home import pass_home
from rossec.cli.shared.batch import Batch, unique
from rossec.cli.shared.results import json_result
from rossec.overlay.router_home import RouterHome, new_password
from rossec.overlay.routers import check_seat
from rossec.terminal import note, say, say_json, say_secret


def _reached(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options of what makes a seat file: where the router is found, if it was not told yet."""
    listen = click.option(
        "--listen", metavar="LOCATOR", multiple=True,
        help="where this router will listen, if it never ran yet; as of rossec router",
    )  # fmt: skip
    host = click.option(
        "--host", metavar="NAME", multiple=True,
        help="name or address by which relays reach this router; may be repeated",
    )  # fmt: skip
    return host(listen(command))


@click.command()
@click.argument("name")
@_reached
@pass_home
def add(home: RouterHome, name: str, host: tuple[str, ...], listen: tuple[str, ...]) -> None:
    """Make the seat NAME, and print its file for the relay of that site.

    For example: rossec router seats add home > home.seat. The file holds a password: bring it to
    the site as you would a key.
    """
    check_seat(name)
    home.prepare()
    _check_reached(home, host, listen)
    home.change_seats(lambda found: found.add(name, new_password()))
    _print_file(home, name)


@click.command()
@click.argument("name")
@_reached
@pass_home
def show(home: RouterHome, name: str, host: tuple[str, ...], listen: tuple[str, ...]) -> None:
    """Print the file of the seat NAME again, with the routers of now.

    NAME is `open` for a router that was started with --open.
    """
    home.prepare()
    _check_reached(home, host, listen)
    _print_file(home, name)


@click.command("list")
@click.option("--json", "as_json", is_flag=True, help="a line of JSON")
@pass_home
def list_(home: RouterHome, *, as_json: bool) -> None:
    """List the seats."""
    names = home.seats().names
    if as_json:
        say_json({"seats": list(names)})
        return
    for name in names:
        say(name)
    if not names:
        note("nobody has a seat: rossec router seats add NAME > NAME.seat")


@click.command()
@click.argument("names", metavar="NAME...", nargs=-1, required=True)
@json_result()
@pass_home
def remove(home: RouterHome, names: tuple[str, ...]) -> None:
    """Take the seat NAME away; a router that runs cuts its relay off within a second.

    Do it at each router of the operator.
    """
    names = unique(names)
    batch = Batch(len(names), "name")
    for name in names:
        with batch.item(name):
            home.change_seats(methodcaller("remove", name))
            say(f"the seat {name} is no more")
    batch.finish()


def _check_reached(home: RouterHome, host: tuple[str, ...], listen: tuple[str, ...]) -> None:
    """Keep what was told, and find the locators before anything is made for them."""
    home.tell(hosts=host, listen=listen)
    home.settings().locators  # noqa: B018 - raises


def _print_file(home: RouterHome, name: str) -> None:
    say_secret(home.seat_file(name).write().decode().rstrip())
