"""`rossec router share | take`: several routers of one operator."""

import sys
from pathlib import Path

import click

from rossec import files
from rossec.cli.router.home import pass_home
from rossec.cli.shared.results import json_result
from rossec.errors import ConfigurationError
from rossec.overlay.router_home import RouterHome
from rossec.overlay.router_share import MAX_FILE, Share
from rossec.terminal import note, record, say, say_secret


@click.command()
@pass_home
def share(home: RouterHome) -> None:
    """Write what another router of the operator needs to join.

    For example: rossec router share > share.json. It holds the key of the routers' authority and
    the passwords of all seats: bring it to the other host by ssh, and remove it there. Do it again
    when seats were added or removed.
    """
    say_secret(home.share().write().decode().rstrip())
    note("this holds every password of the routers: keep it to yourself")


@click.command()
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False, allow_dash=True))
@click.option("--host", metavar="NAME", multiple=True, help="as of rossec router")
@json_result()
@pass_home
def take(home: RouterHome, file: Path, host: tuple[str, ...]) -> None:
    """Take over FILE of `share` here, and join that router.

    That is its authority, its seats and its address. FILE is - for standard input. A router that
    runs here takes the seats over within a second.
    """
    home.take(Share.read(_read(file)))
    home.tell(hosts=host)
    record(seats=list(home.seats().names), joins=list(home.settings().join))
    say(
        f"seats: {', '.join(home.seats().names) or 'none'}; joins {', '.join(home.settings().join)}"
    )


def _read(file: Path) -> bytes:
    if str(file) == "-":
        return sys.stdin.buffer.read(MAX_FILE + 1)
    missing = ConfigurationError(f"there is no {file}", "it is made by: rossec router share")
    return files.read_own(file, MAX_FILE, missing, link=True)
