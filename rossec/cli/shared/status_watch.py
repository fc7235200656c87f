"""The status of a running service: shown once, or again whenever it changes."""

import time
from collections.abc import Callable
from typing import Any, Final

import click

from rossec.terminal import note, printable, say, say_json

PERIOD: Final = 1.0  # seconds between two questions

as_json = click.option("--json", "as_json", is_flag=True, help="one line of JSON")
watch = click.option(
    "--watch", is_flag=True, help="show it again whenever it changes, until Ctrl-C"
)

Answer = dict[str, Any]


def show_status(
    ask: Callable[[], Answer],
    lines: Callable[[Answer], list[str]],
    missing: Callable[[Answer], str],
    *,
    as_json: bool,
    watch: bool,
) -> None:
    """Ask and print, once or until Ctrl-C; `missing` is said of an answer that lacks something."""
    shown: list[str] | None = None
    while True:
        answer = ask()
        if as_json:
            say_json(answer)
        elif (found := lines(answer)) != shown:
            shown = found
            for line in found:
                say(printable(line))
            if said := missing(answer):
                note(said)
        if not watch:
            return
        time.sleep(PERIOD)
