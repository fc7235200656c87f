"""Run a router until it is stopped, or print its settings for a stock `zenohd`."""

import asyncio
from collections.abc import Mapping

from rossec.cli.shared.context import Environment
from rossec.operation.shutdown import stop_on_signals, until_first_ends
from rossec.operation.systemd import READY, STOPPING, notify
from rossec.overlay.router import Router, seats_of
from rossec.overlay.router_home import RouterHome
from rossec.overlay.router_settings import RouterSettings, nested, zenoh_settings
from rossec.terminal import json_text, note, say, say_block, say_json


def run(
    environment: Environment,
    home: RouterHome,
    given: Mapping[str, tuple[str, ...]],
    *,
    is_open: bool,
    as_json: bool,
) -> None:
    """Run the router of `home` until a signal ends it.

    Args:
        environment: of the command.
        home: its directory.
        given: fields of `RouterSettings` that options set; kept for the next start.
        is_open: it has no seats.
        as_json: print where it listens as JSON.

    Raises:
        ConfigurationError: another one runs there, nobody has a seat, or a file is damaged.
        OverlayUnavailable: zenoh is not installed, or cannot listen there.
    """
    home.prepare()
    with home.alone():
        settings = home.tell(**given)
        seats_of(home, is_open=is_open)
        asyncio.run(_serve(environment, home, settings, is_open=is_open, as_json=as_json))


async def _serve(
    environment: Environment,
    home: RouterHome,
    settings: RouterSettings,
    *,
    is_open: bool,
    as_json: bool,
) -> None:
    stop = stop_on_signals()
    router = Router(home, settings, is_open=is_open)
    try:
        await router.start()
        _print_address(home, settings, is_open=is_open, as_json=as_json)
        notify(READY, environment.variables)
        await until_first_ends(router.run(), stop.wait())
        notify(STOPPING, environment.variables)
    finally:
        await router.close()


def _print_address(
    home: RouterHome, settings: RouterSettings, *, is_open: bool, as_json: bool
) -> None:
    if as_json:
        say_json({"ready": list(settings.listen)})
        return
    say(f"router at {', '.join(settings.listen)}")
    if is_open:
        note("it is open: whoever reaches it can use it, and count what others send")
    else:
        say(f"seats: {', '.join(home.seats().names)}")
    if settings.join:
        say(f"joins {', '.join(settings.join)}")


def print_settings(
    home: RouterHome, given: Mapping[str, tuple[str, ...]], *, is_open: bool
) -> None:
    """Print what `zenohd --config FILE` reads; it names files of `home`, which are made.

    Raises:
        ConfigurationError: as for `run`.
    """
    home.prepare()
    settings = home.tell(**given)
    seats = seats_of(home, is_open=is_open)
    home.write_for_zenoh(settings, seats)
    say_block(json_text(nested(zenoh_settings(settings, seats, home.files)), 1))
    if seats is not None:
        note("it holds the password of this router: keep the file to yourself (chmod 600)")
