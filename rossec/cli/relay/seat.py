"""`rossec relay seat`: keep the seat file of the routers' operator."""

from pathlib import Path

import click

from rossec import files
from rossec.cli.relay.home import relay_files
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.results import json_result
from rossec.overlay.routers import MAX_FILE
from rossec.terminal import note, printable, record, say


@click.command()
@click.argument("file", type=options.FILE)
@json_result()
@pass_environment
def seat(environment: Environment, file: Path) -> None:
    """Keep the seat FILE that the operator of the routers made.

    It has a password in it. A relay that runs uses it when it is started again.
    """
    store = relay_files(environment)
    before = store.routers().seat if store.has_seat else ""
    found = store.keep_seat(files.read(file, MAX_FILE))
    record(seat=found.seat, locators=list(found.locators))
    say(printable(f"seat {found.seat} at {' '.join(found.locators)}"))
    if before and before != found.seat:
        note("the mailboxes have other keys now: hand out the cards again, rossec relay card LABEL")
    note(f"{file} is not needed any more, and whoever has it has the seat: remove it")
