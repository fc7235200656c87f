"""Run a border router until it is stopped."""

import asyncio
from typing import Final

from rossec import clock
from rossec.border import status
from rossec.border.handshakes import StaticKey
from rossec.border.router import BorderRouter
from rossec.cli.shared.context import Environment, now
from rossec.cli.shared.master import with_master
from rossec.errors import ConfigurationError, NotWritten
from rossec.home import NodeHome
from rossec.master.operation.descriptor_limit import raise_descriptor_limit
from rossec.operation.process_lock import process_lock
from rossec.operation.shutdown import stop_on_signals, until_first_ends
from rossec.operation.systemd import READY, STOPPING, notify
from rossec.saved_things import ThingFiles
from rossec.terminal import note, say, say_json

LOCK: Final = "border.lock"


def run(environment: Environment, name: str, host: str, port: int, *, as_json: bool) -> None:
    """Run the border router `name` until a signal ends it.

    Args:
        environment: of the command.
        name: of its node.
        host, port: where it listens for things.
        as_json: print where it listens as JSON.

    Raises:
        HintedError: it has no identity, another one runs, the master is out of reach.
    """
    home = NodeHome.of(environment.home, name)
    home.identity(now())
    busy = ConfigurationError(f"{name} runs already", "see: rossec border status")
    with process_lock(home.path / LOCK, busy):
        raise_descriptor_limit()
        asyncio.run(_serve(environment, home, host, port, as_json=as_json))


async def _serve(
    environment: Environment, home: NodeHome, host: str, port: int, *, as_json: bool
) -> None:
    stop = stop_on_signals()
    key = StaticKey(ThingFiles(home).router_key())
    router = BorderRouter(home.name, key, await with_master(environment, home), host, port)
    try:
        await router.start()
        _print_ready(router, as_json=as_json)
        notify(READY, environment.variables)
        await until_first_ends(router.wait_ended(), _write_status(router), stop.wait())
        notify(STOPPING, environment.variables)
    finally:
        await router.close()
        (home.path / status.FILE).unlink(missing_ok=True)


def _print_ready(router: BorderRouter, *, as_json: bool) -> None:
    host, port = router.server.address
    if as_json:
        say_json({"ready": [host, port], "things": len(router.roster)})
        return
    say(
        f"border router {router.node.name} at {host} port {port} (UDP), {len(router.roster)} things"
    )
    if not len(router.roster):
        note("add things: rossec border add NAME --key FILE")


async def _write_status(router: BorderRouter) -> None:
    """Say what it does, again and again; a full disk is no reason to end."""
    while True:
        try:
            status.write(router.node.home.path, status.describe(router, clock.now()))
        except NotWritten as error:
            note(str(error))
        await asyncio.sleep(status.PERIOD)
