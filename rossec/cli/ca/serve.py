"""`rossec ca serve`: the authority as a service, which holds the key."""

import asyncio
import logging
from contextlib import ExitStack
from pathlib import Path

import click

from rossec.authority.home import AUDIT_FILE, AuthorityHome
from rossec.authority.keyservice.lock import service_lock
from rossec.authority.keyservice.messages import MAX_UNLOCKED, SOCKET
from rossec.authority.keyservice.process import (
    KeyServiceProcess,
    audit_to,
    operations_of,
)
from rossec.authority.keyservice.server import admit_all
from rossec.cli.shared import passphrase
from rossec.cli.shared.context import Environment, UnlockTime, pass_environment
from rossec.clock import format_duration
from rossec.operation.audit_log import audit_written
from rossec.operation.json_log import log_as_json
from rossec.operation.process_memory import protect_memory
from rossec.operation.shutdown import stop_on_signals, until_first_ends
from rossec.operation.systemd import READY, STOPPING, notify
from rossec.terminal import say, say_json

OPERATOR = "the operator who started it"


@click.command()
@click.option(
    "--unlock-for", "seconds", type=UnlockTime(MAX_UNLOCKED), default="15m", show_default=True,
    help="how long the key is held; 0: while it runs",
)  # fmt: skip
@click.option("--locked", is_flag=True, help="start without the key: rossec ca unlock")
@click.option("--log", type=click.Choice(["text", "json"]), help="form of the log on stderr")
@click.option("--json", "as_json", is_flag=True, help="say that it is ready as a line of JSON")
@passphrase.option
@pass_environment
def serve(
    environment: Environment,
    seconds: int,
    locked: bool,
    log: str | None,
    as_json: bool,
    passphrase_file: Path | None,
) -> None:
    """Hold the authority's key, so that commands need no passphrase. Ends with Ctrl-C."""
    home = AuthorityHome.at(environment.home)
    if log == "json":
        log_as_json()
    with ExitStack() as stack:
        protect_memory()
        stack.enter_context(service_lock(home.path))
        audit = stack.enter_context(audit_written(home.path / AUDIT_FILE, home.node().signer()))
        operations = operations_of(home, audit_to(audit))
        if not locked:
            secret = passphrase.read(passphrase_file, environment.variables)
            operations.unlock(secret, seconds, OPERATOR)
            del secret
        process = KeyServiceProcess(home, operations, admit_all)
        asyncio.run(_serve(environment, home, process, as_json=as_json))


async def _serve(
    environment: Environment, home: AuthorityHome, process: KeyServiceProcess, *, as_json: bool
) -> None:
    stop = stop_on_signals()
    audit = logging.getLogger("rossec.audit")
    try:
        await process.start()
        audit.info("the service began")
        _print_state(home, process.operations.held.remaining(), as_json=as_json)
        notify(READY, environment.variables)
        await until_first_ends(stop.wait(), process.watch_time())
        notify(STOPPING, environment.variables)
    finally:
        await process.close()
        audit.info("the service ended")


def _print_state(home: AuthorityHome, remaining: int | None, *, as_json: bool) -> None:
    if as_json:
        say_json({"ready": str(home.path / SOCKET), "remaining": remaining})
        return
    say(f"authority of {home.domain}: {describe_remaining(remaining)}")


def describe_remaining(remaining: int | None) -> str:
    """Whether the key is held, and for how long (`HeldKey.remaining`), for people."""
    if remaining is None:
        return "locked; unlock it with: rossec ca unlock --for 15m"
    return f"unlocked for {format_duration(remaining)}" if remaining else "unlocked while it runs"
