"""Run a border router until it is stopped."""

import asyncio

from rossec import clock
from rossec.border import border_router
from rossec.border.border_router import BorderRouter
from rossec.border.handshakes import StaticKey
from rossec.cli.shared.context import Environment, now
from rossec.cli.shared.master import with_master
from rossec.errors import ConfigurationError, NotWritten
from rossec.home import NodeHome
from rossec.host.local_sockets import process_lock
from rossec.host.runner import stop_on_signals, until_stopped
from rossec.master.operation import raise_descriptor_limit
from rossec.saved_statements import ThingFiles
from rossec.terminal import note, say, say_json


def run(environment: Environment, name: str, host: str, port: int, *, as_json: bool) -> None:
    """Run the border router `name`, which listens for things at `host` and `port`, until a signal ends it."""
    home = NodeHome.of(environment.home, name)
    home.identity(now())

    async def serve() -> None:
        stop = stop_on_signals()
        key = StaticKey(ThingFiles(home).router_key())
        router = BorderRouter(home.name, key, await with_master(environment, home), host, port)

        async def write_status() -> None:
            while True:
                try:
                    status = border_router.describe_status(router, clock.now())
                    border_router.write_status(home.path, status)
                except NotWritten as error:  # a full disk ends no thing
                    note(str(error))
                await asyncio.sleep(border_router.STATUS_PERIOD)

        try:
            await router.start()
            address, count = router.server.address, len(router.roster)
            if as_json:
                say_json({"ready": list(address), "things": count})
            else:
                say(f"border router {home.name} at {address[0]} port {address[1]} (UDP), {count} things")
                if not count:
                    note("add things: rossec border add NAME --key FILE")
            await until_stopped(stop, environment.variables, router.wait_ended(), write_status())
        finally:
            await router.close()
            (home.path / border_router.STATUS_FILE).unlink(missing_ok=True)

    busy = ConfigurationError(f"{name} runs already", "see: rossec border status")
    with process_lock(home.path / "border.lock", busy):
        raise_descriptor_limit()
        asyncio.run(serve())
