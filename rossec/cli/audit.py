"""`rossec audit`: what the master denied, and what was administered."""

from pathlib import Path

import click

from rossec.cli.context import Environment, moment, pass_environment
from rossec.cli.voice import note, printable, say
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.master import audit as audits
from rossec.ros.names import MASTER

AUDIT = "audit.log"


@click.command()
@click.option("--json", "as_json", is_flag=True, help="the lines as they are")
@click.option("--since", type=click.IntRange(0), help="seconds since the epoch")
@click.option("--verify", "verified", is_flag=True, help="check that nothing was changed")
@click.argument("files", nargs=-1, type=click.Path(path_type=Path, dir_okay=False))
@pass_environment
def audit(
    environment: Environment,
    as_json: bool,
    since: int | None,
    verified: bool,
    files: tuple[Path, ...],
) -> None:
    """Show the master's audit: what was denied, and what was administered.

    FILES are the audit in the order of its parts, by default the one the master writes now.
    """
    paths = files or (NodeHome.of(environment.home, MASTER).path / AUDIT,)
    entries: list[audits.Entry] = []
    for path in paths:
        found, damaged = _of(path)
        if damaged and verified:
            raise ConfigurationError(f"line {damaged[0]} of {path} is damaged", "compare a backup")
        for number in damaged:
            note(f"line {number} of {path} is damaged and not shown")
        entries += found
    last = audits.verify(entries) if verified else ""
    for entry in entries:
        if since is None or entry["at"] >= since:
            say(audits.encode(entry) if as_json else _for_people(entry))
    if verified:
        note(f"nothing was changed in {len(entries)} lines; the last is {last}")


def _of(path: Path) -> tuple[list[audits.Entry], list[int]]:
    try:
        with path.open(encoding="utf-8", errors="replace") as lines:
            return audits.salvage(lines)
    except FileNotFoundError:
        raise ConfigurationError(f"there is no {path}", "has the master run here?") from None


def _for_people(entry: audits.Entry) -> str:
    notes = (
        ("left_out", "lines like it before it were left out"),
        ("cut_short", "bytes before it were cut short"),
    )
    more = "".join(f" ({entry[key]} {text})" for key, text in notes if key in entry)
    return printable(f"{moment(int(entry['at']))}  {entry['text']}{more}")
