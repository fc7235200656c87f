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
    entries = [
        entry
        for path in files or (NodeHome.of(environment.home, MASTER).path / AUDIT,)
        for entry in _of(path)
    ]
    last = audits.verify(entries) if verified else ""
    for entry in entries:
        if since is not None and entry["at"] < since:
            continue
        say(audits.encode(entry) if as_json else _for_people(entry))
    if verified:
        note(f"nothing was changed in {len(entries)} lines; the last is {last}")


def _of(path: Path) -> list[audits.Entry]:
    try:
        with path.open(encoding="utf-8", errors="replace") as lines:
            return list(audits.read(lines))
    except FileNotFoundError:
        raise ConfigurationError(f"there is no {path}", "has the master run here?") from None


def _for_people(entry: audits.Entry) -> str:
    left_out = entry.get("left_out", 0)
    more = f" ({left_out} lines before it were left out)" if left_out else ""
    return printable(f"{moment(int(entry['at']))}  {entry['text']}{more}")
