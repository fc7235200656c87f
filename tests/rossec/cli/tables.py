"""All commands, from the tables of the lazy groups."""

from collections.abc import Iterator

import click

from rossec.cli.shared.context import LazyCommand


def all_commands(
    group: click.Group, path: tuple[str, ...] = ("rossec",)
) -> Iterator[tuple[tuple[str, ...], LazyCommand | None, click.Command]]:
    """Every command: its words, how it is listed, and itself; the group first."""
    yield path, None, group
    for name, listed in group.commands.items():
        command = listed.load() if isinstance(listed, LazyCommand) else listed
        lazy = listed if isinstance(listed, LazyCommand) else None
        if isinstance(command, click.Group):
            yield from all_commands(command, (*path, name))
        else:
            yield (*path, name), lazy, command
