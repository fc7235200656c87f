"""Run a router until it is stopped, or print its settings for a stock `zenohd`."""

import asyncio
from collections.abc import Mapping

from rossec.cli.shared.context import Environment
from rossec.host.runner import stop_on_signals, until_stopped
from rossec.overlay.homes import RouterHome
from rossec.overlay.router import Router, accounts_of
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
    """Run the router of `home` until a signal ends it; what was `given` is kept for the next start."""
    home.prepare()

    async def serve(settings: RouterSettings) -> None:
        stop = stop_on_signals()
        router = Router(home, settings, is_open=is_open)
        try:
            await router.start()
            if as_json:
                say_json({"ready": list(settings.listen)})
            else:
                say(f"router at {', '.join(settings.listen)}")
                if is_open:
                    note("it is open: whoever reaches it can use it, and count what others send")
                else:
                    say(f"accounts: {', '.join(home.accounts().names)}")
                if settings.join:
                    say(f"joins {', '.join(settings.join)}")
            await until_stopped(stop, environment.variables, router.run())
        finally:
            await router.close()

    with home.alone():
        settings = home.tell(**given)
        accounts_of(home, is_open=is_open)
        asyncio.run(serve(settings))


def print_settings(home: RouterHome, given: Mapping[str, tuple[str, ...]], *, is_open: bool) -> None:
    """Print what `zenohd --config FILE` reads; it names files of `home`, which are made."""
    home.prepare()
    settings = home.tell(**given)
    accounts = accounts_of(home, is_open=is_open)
    home.write_for_zenoh(settings, accounts)
    say_block(json_text(nested(zenoh_settings(settings, accounts, home.files)), 1))
    if accounts is not None:
        note("it holds the password of this router: keep the file to yourself (chmod 600)")
