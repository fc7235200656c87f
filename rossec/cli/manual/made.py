"""What a build makes of the commands: manual pages, and the outlines for completion. A shell.

`hatch_build.py` puts them into the wheel.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import click

from rossec.cli.completion.outline import Outline, outline_of
from rossec.cli.manual.pages import pages
from rossec.cli.shared.lazy import LazyCommand


def make(group: click.Group, version: str, directory: Path) -> tuple[list[Path], Path]:
    """Write the pages below `man1`, and the outlines; both are the same for the same commands."""
    folder = directory / "man1"
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, text in pages(group, version).items():
        written.append(folder / name)
        written[-1].write_text(text)
    table = directory / "outlines.json"
    table.write_text(json.dumps({"outlines": dict(outlines(group))}, sort_keys=True))
    return written, table


def outlines(group: click.Group) -> Iterator[tuple[str, Outline]]:
    """The outlines of all commands of a lazy group, by their places."""
    for listed in group.commands.values():
        if isinstance(listed, LazyCommand):
            command = listed.load()
            if isinstance(command, click.Group):
                yield from outlines(command)
            else:
                yield listed.place, outline_of(command)
